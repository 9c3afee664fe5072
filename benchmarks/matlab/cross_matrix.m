function M = cross_matrix(a)
% CROSS_MATRIX  M with M b = a x b.
M = [0, -a(3), a(2); a(3), 0, -a(1); -a(2), a(1), 0];
end
