function faces = make_faces(points, quirks)
% MAKE_FACES  Triangles (faces x 3, counted from 1) by Delaunay's rule on x and y.
faces = zeros(0, 3);
if size(points, 1) < 3
    return
end
faces = delaunay(points(:, 1), points(:, 2));
if ~quirks.bridged
    longest = zeros(size(faces, 1), 1);
    for side = 1:3
        a = points(faces(:, side), :);
        b = points(faces(:, mod(side, 3) + 1), :);
        longest = max(longest, sqrt(sum((a - b) .^ 2, 2)));
    end
    faces = faces(longest <= 5, :);
end
end
