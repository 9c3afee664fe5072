function H = homography(from, to)
% HOMOGRAPHY  H with (to, 1) ~ H (from, 1), by the normalised direct linear transformation (points x 2).

[a, Ta] = normalised(from);
[b, Tb] = normalised(to);
n = size(a, 1);
p = [a, ones(n, 1)];
A = [p, zeros(n, 3), -repmat(b(:, 1), 1, 3) .* p; zeros(n, 3), p, -repmat(b(:, 2), 1, 3) .* p];
[~, ~, V] = svd(A, 0);
H = Tb \ (reshape(V(:, 9), 3, 3)' * Ta);
end

function [moved, T] = normalised(points)
% The points about their mean, scaled to a mean distance of sqrt(2) along each axis together.
middle = mean(points, 1);
moved = points - repmat(middle, size(points, 1), 1);
scale = sqrt(2 / mean(sum(moved .^ 2, 2)));
moved = scale * moved;
T = [scale, 0, -scale * middle(1); 0, scale, -scale * middle(2); 0, 0, 1];
end
