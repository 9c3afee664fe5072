function [rotation, translation] = board_pose(board, corners, fc, cc, kc)
% BOARD_POSE  Rotation vector and translation of a board (mm) with the camera held: homography, then Gauss-Newton.
%   Corners that are NaN are left out.

used = ~isnan(corners(:, 1));
board = board(used, :);
corners = corners(used, :);
H = homography(board, normalise(corners, fc, cc, kc, 20));
H = H / ((norm(H(:, 1)) + norm(H(:, 2))) / 2);
if H(3, 3) < 0
    H = -H;
end
[U, ~, V] = svd([H(:, 1:2), cross(H(:, 1), H(:, 2))]);
rotation = rotation_vector(U * diag([1, 1, det(U * V')]) * V');
translation = H(:, 3);

for iteration = 1:20
    [seen, ~, J] = project(board, rotation, translation, fc, cc, kc);
    step = (J' * J) \ (J' * reshape((corners - seen)', [], 1));
    rotation = rotation + step(1:3);
    translation = translation + step(4:6);
    if norm(step) < 1e-10 * norm([rotation; translation])
        break
    end
end
end
