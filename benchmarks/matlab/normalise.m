function x = normalise(pixels, fc, cc, kc, iterations)
% NORMALISE  Pixels counted from 0 (points x 2) to x and y of their rays, the distortion undone by fixed-point iterations.
distorted = [(pixels(:, 1) - cc(1)) / fc(1), (pixels(:, 2) - cc(2)) / fc(2)];
x = distorted;
for iteration = 1:iterations
    stretch = 1 + kc * (x(:, 1) .^ 2 + x(:, 2) .^ 2);
    x = distorted ./ [stretch, stretch];
end
end
