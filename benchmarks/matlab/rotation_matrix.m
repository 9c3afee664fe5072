function R = rotation_matrix(w)
% ROTATION_MATRIX  Rodrigues' formula: the rotation about w by |w| radians.
angle = norm(w);
if angle < 1e-12
    R = eye(3) + cross_matrix(w);
else
    K = cross_matrix(w / angle);
    R = eye(3) + sin(angle) * K + (1 - cos(angle)) * K ^ 2;
end
end
