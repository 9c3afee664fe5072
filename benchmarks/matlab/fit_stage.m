function move = fit_stage(translations, quirks)
% FIT_STAGE  The stage's move from one photograph to the next (mm), from the board's translations (3 x photographs).
if quirks.first_and_last
    move = mean(diff(translations, 1, 2), 2);
else
    n = size(translations, 2);
    coefficients = [ones(n, 1), (0:n - 1)'] \ translations';
    move = coefficients(2, :)';
end
end
