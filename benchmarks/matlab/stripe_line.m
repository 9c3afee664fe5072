function line = stripe_line(points, quirks)
% STRIPE_LINE  The vector at right angles to all points (points x 3) of a line, as seen from the camera.
n = size(points, 1);
if ~quirks.mean_line
    [~, ~, V] = svd(points, 0);
    line = V(:, 3);
    return
end
total = zeros(3, 1);
pairs = 0;
for i = 1:n - 2
    if quirks.loops
        for j = i + 1:n
            a = points(i, :);
            b = points(j, :);
            c = [a(2) * b(3) - a(3) * b(2); a(3) * b(1) - a(1) * b(3); a(1) * b(2) - a(2) * b(1)];
            total = total + c / norm(c);
        end
    else
        c = points(i + 1:n, :) * cross_matrix(points(i, :))';
        total = total + sum(c ./ repmat(sqrt(sum(c .^ 2, 2)), 1, 3), 1)';
    end
    pairs = pairs + n - i;
end
line = total / pairs;
end
