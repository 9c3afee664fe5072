function w = rotation_vector(R)
% ROTATION_VECTOR  The axis of a rotation times its angle, 0 to pi.
twice = [R(3, 2) - R(2, 3); R(1, 3) - R(3, 1); R(2, 1) - R(1, 2)];
sine = norm(twice) / 2;
cosine = (trace(R) - 1) / 2;
if sine > 1e-6
    w = atan2(sine, cosine) / (2 * sine) * twice;
elseif cosine > 0
    w = twice / 2;
else
    % Half a turn: R + I = 2 a a'.
    [~, k] = max(diag(R));
    axis_of = R(:, k);
    axis_of(k) = axis_of(k) + 1;
    w = pi * axis_of / norm(axis_of);
end
end
