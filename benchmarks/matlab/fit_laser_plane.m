function plane = fit_laser_plane(planes, lines, stripes, quirks)
% FIT_LASER_PLANE  The dual plane of the laser. Every plane through the stripe on board i is planes_i + a lines_i.
if ~quirks.mean_of_pairs
    X = cat(1, stripes{:});
    middle = mean(X, 1);
    [~, ~, V] = svd(X - repmat(middle, size(X, 1), 1), 0);
    plane = V(:, 3) / (middle * V(:, 3));
    return
end
views = size(planes, 2);
total = zeros(3, 1);
pairs = 0;
for i = 1:views - 2
    for j = i + 1:views
        A = [lines(:, i), -lines(:, j)];
        a = (A' * A) \ (A' * (planes(:, j) - planes(:, i)));
        total = total + (planes(:, i) + a(1) * lines(:, i) + planes(:, j) + a(2) * lines(:, j)) / 2;
        pairs = pairs + 1;
    end
end
plane = total / pairs;
end
