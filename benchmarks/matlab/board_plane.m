function plane = board_plane(rotation, translation, quirks)
% BOARD_PLANE  The dual plane of a board: plane . X = 1 for every X on it (1/mm).
R = rotation_matrix(rotation);
n = R(:, 3);
if quirks.board_sign
    plane = -n / abs(n' * translation);
else
    plane = n / (n' * translation);
end
end
