function v = law(path, v, e)
% The next trial's signal in MATLAB or Octave: v = law("law.json", v, e), of (23),
%
%     v_{k+1} = Q (v_k + L e_k).
%
% path names a file of ilctools.save_law, for `ends` "zero" and without limits, as those of a table
% are, or with `reach`; v and e are those of a whole trial, a row for each sample, a column for
% each of their channels.
% It needs MATLAB R2016b or newer, or Octave 7 or newer. The same as law.c, in fewer checks: the
% file is taken to be as save_law wrote it.
saved = jsondecode(fileread(path));
formats = {"rodlib law 1", "rodlib law 2", "rodlib law 3"};
is_known = isfield(saved, "format") && any(strcmp(saved.format, formats));
keeps_outputs = isfield(saved, "outputs");
refuse(keeps_outputs, "limits of outputs need the model of the plant: learn by ilctools");
refuse(~is_known, "%s is no file of save_law, or a newer one", path);
is_limited = isfield(saved, "actuators") && ~isempty(fieldnames(saved.actuators));
refuse(is_limited, "there must be no limits, but the law has some");
is_finite = ~isfield(saved.L, "base") || isempty(saved.L.base);
refuse(~is_finite, "the base is a model; synthesise with reach");
refuse(~all(strcmp({saved.Q.ends, saved.L.ends}, "zero")), "`ends` must be zero");
taps = saved.L.coefficients;  % (m, p, order)
m = size(taps, 1);
p = size(taps, 2);
rest = value_of(saved, "rest", 0);
gain = value_of(saved, "step", 1);
numbers = {taps, saved.sections, rest, gain};
are_finite = cellfun(@(x) isnumeric(x) && all(isfinite(x(:))), numbers);
refuse(~all(are_finite), "%s holds numbers that are not finite", path);
[n, columns] = size(v);
refuse(columns ~= m || ~isequal(size(e), [n, p]), "v must have %d columns, and e %d", m, p);
refuse(~all(isfinite([v(:); e(:)])), "v and e must be finite numbers");
refuse(n <= rest, "the trial has %d samples, the rest %d", n, rest);

made = v + look(taps, value_of(saved.L, "first", 1), e);  % v + L e
v = (1 - gain) * v + gain * both_ways(saved.sections, made);
v(n - rest + 1 : n, :) = 0;
refuse(~all(isfinite(v(:))), "the next v is not finite: v or e is too large");
end

function out = look(taps, first, in)
% L in: the sum over k of taps(:, :, k) in(p + first + k - 1), beyond the ends zero.
n = size(in, 1);
out = zeros(n, size(taps, 1));
for k = 1 : size(taps, 3)
    ahead = first + k - 1;
    p = max(1, 1 - ahead) : min(n, n - ahead);
    out(p, :) = out(p, :) + in(p + ahead, :) * taps(:, :, k).';
end
end

function x = both_ways(sections, x)
% Q x: all sections forward from rest, then backward from beyond the end, where their response has
% decayed to rounding; there they begin at rest at what the forward ones hold.
n = size(x, 1);
radius = max(arrayfun(@(s) max(abs(roots(sections(s, 4:6)))), 1 : size(sections, 1)));
x = [x; zeros(ceil(log(1e-18) / log(radius)), size(x, 2))];
for backward = [false, true]
    held = backward * x(end, :);
    if backward, x = flipud(x); end
    for s = 1 : size(sections, 1)
        b = sections(s, 1:3);
        a = sections(s, 4:6);
        rises = sum(b) / sum(a);
        x = filter(b, a, x, [rises - b(1); b(3) - rises * a(3)] * held);
        held = rises * held;
    end
end
x = flipud(x);
x = x(1 : n, :);
end

function value = value_of(saved, key, value)
% What a file says, or else the default.
if isfield(saved, key), value = saved.(key); end
end

function refuse(is_wrong, varargin)
if is_wrong, error(["law: ", varargin{1}], varargin{2 : end}); end
end
