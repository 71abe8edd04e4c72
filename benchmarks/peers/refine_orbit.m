% Refine a periodic orbit of a chain of uniform rods (l = 1 m, m = 1 kg, g = 9.8 m/s^2) by single shooting with sqp.
% The integrator is Dormand and Prince's 5(4), the method of ode45, written out: Octave's own ode45 is slower.
% usage: octave refine_orbit.m ANGLES... RATES... PERIOD
1;
function dx = field(x, A, b)
  n = numel(x) / 2; q = x(1:n); v = x(n+1:end);
  d = q - q';
  dx = [v; -(A .* cos(d)) \ ((A .* sin(d)) * v.^2 + b .* sin(q))];
end
function e = energy(x, A, b)
  n = numel(x) / 2; q = x(1:n); v = x(n+1:end);
  e = 0.5 * v' * (A .* cos(q - q')) * v - b' * cos(q);
end
function x = flow(x, T, A, b)
  rtol = 1e-10; atol = 1e-12; t = 0; h = T / 100; k1 = field(x, A, b);
  while t < T
    h = min(h, T - t);
    k2 = field(x + h * (k1 / 5), A, b);
    k3 = field(x + h * (3/40 * k1 + 9/40 * k2), A, b);
    k4 = field(x + h * (44/45 * k1 - 56/15 * k2 + 32/9 * k3), A, b);
    k5 = field(x + h * (19372/6561 * k1 - 25360/2187 * k2 + 64448/6561 * k3 - 212/729 * k4), A, b);
    k6 = field(x + h * (9017/3168 * k1 - 355/33 * k2 + 46732/5247 * k3 + 49/176 * k4 - 5103/18656 * k5), A, b);
    y = x + h * (35/384 * k1 + 500/1113 * k3 + 125/192 * k4 - 2187/6784 * k5 + 11/84 * k6);
    k7 = field(y, A, b);
    e = h * (71/57600 * k1 - 71/16695 * k3 + 71/1920 * k4 - 17253/339200 * k5 + 22/525 * k6 - 1/40 * k7);
    err = norm(e ./ (atol + rtol * max(abs(x), abs(y))), Inf);
    if err <= 1
      t += h; x = y; k1 = k7;
    end
    h *= min(5, max(0.2, 0.9 * err^(-1/5)));
  end
end
function r = conditions(w, E, A, b)
  x = w(1:end-1); g = flow(x, w(end), A, b) - x;
  r = [g(1:end-1); energy(x, A, b) - E];   % the last closure row follows from the energy
end
arguments = argv(); w0 = cellfun(@str2double, arguments(:)); n = (numel(w0) - 1) / 2;
arm = tril(ones(n), -1) + 0.5 * eye(n);
A = arm' * arm + eye(n) / 12; b = 9.8 * sum(arm, 1)';
E = energy(w0(1:end-1), A, b);
started = tic;
nearest = {@(w) 0.5 * sumsq(w - w0), @(w) w - w0, @(w) eye(numel(w0))};
w = sqp(w0, nearest, @(w) conditions(w, E, A, b), [], [], [], 20, 1e-12);
printf("%.17g\n", toc(started), w);
