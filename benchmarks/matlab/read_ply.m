function [points, faces] = read_ply(name)
% READ_PLY  Points and faces (counted from 1) of an ASCII PLY file of x, y, z and faces of one kind, value by value.
file = fopen(name, 'r');
vertices = 0;
count = 0;
words = fgetl(file);
while ~strcmp(words, 'end_header')
    if strncmp(words, 'format', 6) && isempty(strfind(words, 'ascii')) %#ok<STREMP>
        fclose(file);
        error('%s: only ASCII is read', name);
    elseif strncmp(words, 'element vertex', 14)
        vertices = sscanf(words, 'element vertex %d');
    elseif strncmp(words, 'element face', 12)
        count = sscanf(words, 'element face %d');
    end
    words = fgetl(file);
end
points = zeros(vertices, 3);
for k = 1:vertices
    for axis_of = 1:3
        points(k, axis_of) = fscanf(file, '%f', 1);
    end
end
faces = [];
for k = 1:count
    corners = fscanf(file, '%d', 1);
    for i = 1:corners
        faces(k, i) = fscanf(file, '%d', 1) + 1; %#ok<AGROW>
    end
end
fclose(file);
end
