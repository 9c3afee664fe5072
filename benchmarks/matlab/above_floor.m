function kept = above_floor(points, clicks, quirks)
% ABOVE_FLOOR  Which points are further than 5 mm, along z, from the plane through the points nearest to some clicks.
picks = zeros(size(clicks, 1), 3);
for k = 1:size(clicks, 1)
    [~, nearest] = min((points(:, 1) - clicks(k, 1)) .^ 2 + (points(:, 2) - clicks(k, 2)) .^ 2);
    picks(k, :) = points(nearest, :);
end
if quirks.first_pick
    through = picks(1, :);
    picks = picks(2:end, :);
else
    through = mean(picks, 1);
end
offset = picks - repmat(through, size(picks, 1), 1);
slopes = offset(:, 1:2) \ offset(:, 3);
from = points - repmat(through, size(points, 1), 1);
kept = abs(from(:, 3) - from(:, 1:2) * slopes) > 5;
end
