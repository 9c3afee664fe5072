function [fc, cc, kc, rotations, translations] = calibrate_camera(board, corners, image_size)
% CALIBRATE_CAMERA  Focal lengths, principal point, one radial term and the pose of every view.
%
%   A closed-form start from the homographies, then Gauss-Newton on all corners but those that are NaN. No skew, no
%   tangential terms. Pixels are counted from 0.

views = size(corners, 3);
cc = (image_size(:) - 1) / 2;
fc = focal_start(board, corners, cc);
kc = 0;
rotations = zeros(3, views);
translations = zeros(3, views);
for k = 1:views
    [rotations(:, k), translations(:, k)] = board_pose(board, corners(:, :, k), fc, cc, kc);
end

for iteration = 1:30
    n = 5 + 6 * views;
    JtJ = zeros(n);
    Jte = zeros(n, 1);
    for k = 1:views
        used = ~isnan(corners(:, 1, k));
        [seen, J_camera, J_pose] = project(board(used, :), rotations(:, k), translations(:, k), fc, cc, kc);
        error = reshape((corners(used, :, k) - seen)', [], 1);
        pose = 5 + 6 * (k - 1) + (1:6);
        JtJ(1:5, 1:5) = JtJ(1:5, 1:5) + J_camera' * J_camera;
        JtJ(1:5, pose) = J_camera' * J_pose;
        JtJ(pose, 1:5) = J_pose' * J_camera;
        JtJ(pose, pose) = J_pose' * J_pose;
        Jte(1:5) = Jte(1:5) + J_camera' * error;
        Jte(pose) = J_pose' * error;
    end
    step = JtJ \ Jte;
    fc = fc + step(1:2);
    cc = cc + step(3:4);
    kc = kc + step(5);
    change = reshape(step(6:end), 6, views);
    rotations = rotations + change(1:3, :);
    translations = translations + change(4:6, :);
    if norm(step(1:5)) < 1e-9 * norm([fc; cc; kc])
        break
    end
end
end

function fc = focal_start(board, corners, cc)
% With the principal point moved to the origin a view's homography ~ diag(fu, fv, 1) [r1 r2 T]. That r1 and r2 are
% orthogonal and of one length is linear in 1 / fu^2 and 1 / fv^2.
A = zeros(0, 2);
b = zeros(0, 1);
for k = 1:size(corners, 3)
    used = ~isnan(corners(:, 1, k));
    H = [1, 0, -cc(1); 0, 1, -cc(2); 0, 0, 1] * homography(board(used, :), corners(used, :, k));
    H = H / norm(H(:));
    A = [A; (H(1:2, 1) .* H(1:2, 2))'; (H(1:2, 1) .^ 2 - H(1:2, 2) .^ 2)']; %#ok<AGROW>
    b = [b; -H(3, 1) * H(3, 2); H(3, 2) ^ 2 - H(3, 1) ^ 2]; %#ok<AGROW>
end
fc = sqrt(1 ./ abs(A \ b));
end
