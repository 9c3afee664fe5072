function pixels = stripe_pixels(photo, threshold, quirks)
% STRIPE_PIXELS  Column and row of the stripe, one row of the result for each image column in which it is found.
photo = double(photo);
response = (photo(:, :, 1) - photo(:, :, 2)) + (photo(:, :, 1) - photo(:, :, 3));
if quirks.loops
    pixels = zeros(0, 2);
    for column = 1:size(response, 2)
        rows = find(response(:, column) >= threshold);
        if ~isempty(rows)
            pixels = [pixels; column, mean(rows)]; %#ok<AGROW>
        end
    end
else
    bright = response >= threshold;
    count = sum(bright, 1);
    columns = find(count);
    sums = (1:size(response, 1)) * bright;
    pixels = [columns', (sums(columns) ./ count(columns))'];
end
if quirks.whole_rows
    pixels(:, 2) = round(pixels(:, 2));
end
if ~quirks.pixels_from_one
    pixels = pixels - 1;
end
end
