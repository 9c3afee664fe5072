function points = triangulate(pixels, fc, cc, kc, plane, quirks)
% TRIANGULATE  Where the rays of pixels (points x 2) meet a plane (mm, camera frame).
iterations = 20;
if ~quirks.few_iterations
    iterations = 200;
end
n = size(pixels, 1);
points = zeros(n, 3);
if quirks.loops
    for k = 1:n
        x = [normalise(pixels(k, :), fc, cc, kc, iterations), 1];
        points(k, :) = x / (x * plane);
    end
else
    x = [normalise(pixels, fc, cc, kc, iterations), ones(n, 1)];
    points = x ./ repmat(x * plane, 1, 3);
end
end
