function scan2003(input, output)
% SCAN2003  The laser line scanner of 2003: photographs to rig, points and mesh.
%
%   scan2003(INPUT, OUTPUT) reads the MAT file INPUT and writes the MAT file OUTPUT. It runs in MATLAB and in GNU Octave.
%
%   INPUT holds
%     image_size        columns, rows
%     board             corner coordinates on the board, mm (corners x 2); z points at the camera
%     corners           pixels counted from 0 (corners x 2 x views); NaN where one was not found
%     stage_corners     the same of the board on the stage (corners x 2 x photographs)
%     board_photos      file names (cell), one for each view: board and stripe
%     scan_photos       file names (cell)
%     board_threshold, scan_threshold   of the stripe's response
%     clicks            where a person clicked on the floor, x and y, mm (clicks x 2); may be empty
%     ply               file name of the mesh; may be empty
%     quirks            switches; 1 is as it was in 2003, 0 as it should be (see QUIRKS in this file)
%
%   OUTPUT holds fc, cc, kc (camera), rotations, translations (3 x views), planes, lines (3 x views), laser_plane (3 x 1),
%   stage_move (3 x 1, mm a photograph), board_stripes (points x 3: view, column, row), points (points x 3, mm), frame,
%   column, row (points x 1; as the pipeline counts them), kept (points x 1: not floor), faces, and seconds, the time of
%   each step.
%
%   QUIRKS
%     pixels_from_one   stripe pixels are counted from 1, the camera model counts from 0
%     index_from_one    photographs of a scan are counted from 1, so that the first is moved back too
%     whole_rows        the stripe's row is rounded
%     board_sign        the board's plane is -n / |n . T|
%     few_iterations    the distortion is undone by 20 iterations
%     mean_line         a stripe's line vector is the mean of cross products; else a least-squares line
%     mean_of_pairs     the laser plane is the mean over pairs of views; else least squares over all stripe points
%     first_and_last    the stage's move is the mean difference; else a least-squares line
%     first_pick        the floor goes through the first click; else least squares over all clicks
%     bridged           triangles over gaps and steps stay; else those with a side of more than 5 mm are left out
%     loops             one point after the other; else a photograph's points at once

job = load(input);
quirks = job.quirks;
seconds = struct();

tic;
[fc, cc, kc, rotations, translations] = calibrate_camera(job.board, job.corners, job.image_size);
seconds.camera = toc;

tic;
views = size(job.corners, 3);
photos = cell(1, views);
for k = 1:views
    photos{k} = imread(job.board_photos{k});
end
seconds.read_boards = toc;

tic;
pixels = cell(1, views);
board_stripes = zeros(0, 3);
for k = 1:views
    pixels{k} = stripe_pixels(photos{k}, job.board_threshold, quirks);
    board_stripes = [board_stripes; k * ones(size(pixels{k}, 1), 1), pixels{k}]; %#ok<AGROW>
end
seconds.detect_boards = toc;

tic;
planes = zeros(3, views);
lines = zeros(3, views);
stripes = cell(1, views);
for k = 1:views
    planes(:, k) = board_plane(rotations(:, k), translations(:, k), quirks);
    stripes{k} = triangulate(pixels{k}, fc, cc, kc, planes(:, k), quirks);
    lines(:, k) = stripe_line(stripes{k}, quirks);
end
seconds.lines = toc;

tic;
laser_plane = fit_laser_plane(planes, lines, stripes, quirks);
seconds.laser_plane = toc;

tic;
stage_translations = zeros(3, size(job.stage_corners, 3));
for k = 1:size(job.stage_corners, 3)
    [~, stage_translations(:, k)] = board_pose(job.board, job.stage_corners(:, :, k), fc, cc, kc);
end
stage_move = fit_stage(stage_translations, quirks);
seconds.stage = toc;

seconds.read_scan = 0;
seconds.detect = 0;
seconds.triangulate = 0;
points = zeros(0, 3);
pixels = zeros(0, 2);
frame = zeros(0, 1);
for k = 1:numel(job.scan_photos)
    tic;
    photo = imread(job.scan_photos{k});
    seconds.read_scan = seconds.read_scan + toc;
    tic;
    found = stripe_pixels(photo, job.scan_threshold, quirks);
    seconds.detect = seconds.detect + toc;
    tic;
    index = k - 1 + quirks.index_from_one;
    seen = triangulate(found, fc, cc, kc, laser_plane, quirks);
    points = [points; seen - index * repmat(stage_move', size(seen, 1), 1)]; %#ok<AGROW>
    pixels = [pixels; found]; %#ok<AGROW>
    frame = [frame; k * ones(size(found, 1), 1)]; %#ok<AGROW>
    seconds.triangulate = seconds.triangulate + toc;
end
column = pixels(:, 1);
row = pixels(:, 2);

tic;
kept = true(size(points, 1), 1);
if ~isempty(job.clicks) && ~isempty(points)
    kept = above_floor(points, job.clicks, quirks);
end
faces = zeros(0, 3);
if ~isempty(job.ply)
    faces = make_faces(points(kept, :), quirks);
    write_ply(job.ply, points(kept, :), faces);
end
seconds.mesh = toc;

result = struct('fc', fc, 'cc', cc, 'kc', kc, 'rotations', rotations, 'translations', translations, ...
    'planes', planes, 'lines', lines, 'laser_plane', laser_plane, 'stage_move', stage_move, ...
    'board_stripes', board_stripes, 'points', points, 'frame', frame, 'column', column, 'row', row, ...
    'kept', kept, 'faces', faces, 'seconds', seconds); %#ok<NASGU>
save(output, '-struct', 'result', '-v7');
end
