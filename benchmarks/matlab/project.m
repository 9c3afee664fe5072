function [pixels, J_camera, J_pose] = project(board, rotation, translation, fc, cc, kc)
% PROJECT  Board points (mm, points x 2) to pixels counted from 0, with the derivatives by
% [fc; cc; kc] and [rotation; translation]; rows of the derivatives are u and v of each point in turn.

n = size(board, 1);
R = rotation_matrix(rotation);
turned = R(:, 1:2) * board';
X = turned + repmat(translation, 1, n);
x = X(1, :) ./ X(3, :);
y = X(2, :) ./ X(3, :);
r2 = x .^ 2 + y .^ 2;
stretch = 1 + kc * r2;
pixels = [fc(1) * stretch .* x + cc(1); fc(2) * stretch .* y + cc(2)]';

J_camera = zeros(2 * n, 5);
J_camera(1:2:end, 1) = stretch .* x;
J_camera(2:2:end, 2) = stretch .* y;
J_camera(1:2:end, 3) = 1;
J_camera(2:2:end, 4) = 1;
J_camera(1:2:end, 5) = fc(1) * r2 .* x;
J_camera(2:2:end, 5) = fc(2) * r2 .* y;

% By the normalised coordinates, then by the point, then by the pose.
u_x = fc(1) * (stretch + 2 * kc * x .^ 2);
u_y = fc(1) * (2 * kc * x .* y);
v_x = fc(2) * (2 * kc * x .* y);
v_y = fc(2) * (stretch + 2 * kc * y .^ 2);
u_X = [u_x; u_y; -(u_x .* x + u_y .* y)] ./ repmat(X(3, :), 3, 1);
v_X = [v_x; v_y; -(v_x .* x + v_y .* y)] ./ repmat(X(3, :), 3, 1);
J_pose = zeros(2 * n, 6);
J_pose(1:2:end, 4:6) = u_X';
J_pose(2:2:end, 4:6) = v_X';
for i = 1:3
    moved = rotation_derivative(rotation, R, i) * turned;
    J_pose(1:2:end, i) = sum(u_X .* moved, 1);
    J_pose(2:2:end, i) = sum(v_X .* moved, 1);
end
end

function D = rotation_derivative(w, R, i)
% The matrix D with dR / dw_i = D R (Gallego and Yezzi 2015).
e = zeros(3, 1);
e(i) = 1;
if norm(w) < 1e-8
    D = cross_matrix(e);
else
    D = cross_matrix(w(i) * w + cross(w, (eye(3) - R) * e)) / (w' * w);
end
end
