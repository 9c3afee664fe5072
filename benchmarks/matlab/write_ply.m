function write_ply(name, points, faces)
% WRITE_PLY  Points (points x 3) and faces of three or four corners (counted from 1) as an ASCII PLY file.
file = fopen(name, 'w');
fprintf(file, 'ply\nformat ascii 1.0\n');
fprintf(file, 'element vertex %d\n', size(points, 1));
fprintf(file, 'property float x\nproperty float y\nproperty float z\n');
fprintf(file, 'element face %d\n', size(faces, 1));
fprintf(file, 'property list uchar int vertex_indices\nend_header\n');
for k = 1:size(points, 1)
    fprintf(file, '%f %f %f\n', points(k, 1), points(k, 2), points(k, 3));
end
corners = size(faces, 2);
for k = 1:size(faces, 1)
    fprintf(file, '%d', corners);
    fprintf(file, ' %d', faces(k, :) - 1);
    fprintf(file, '\n');
end
fclose(file);
end
