/* The next trial's signal in C99, for a target without Python: v_{k+1} = Q (v_k + L e_k), (23).

   It reads a file of ilctools.save_law and, from the standard input, a line for each sample of the
   trial with v and then e, of all their channels; it prints the next v, a line for each sample. If a trial
   breaks off, or if v, e, a number of the file or the next v is not finite, it prints nothing, says
   why on the standard error and exits with 1. How many samples a whole trial has, its caller may
   say.

       cc -std=c99 -O2 -ffp-contract=off law.c -lm -o law  &&  ./law law.json 2500 < trial > next

   For `ends` "zero" and without limits, as those of a table are, or with `reach`. It refuses
   whatever load_law refuses, but for letters beyond ASCII that are not printable; and escapes other
   than \n, \" and \\, integers of more than 17 digits, and what does not fit into its arrays. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define REFUSE(...) (fprintf(stderr, "law: " __VA_ARGS__), fputc('\n', stderr), exit(1))
#define DAMAGED(what) REFUSE("byte %d of the law: %s", (int)(at - text), what)
enum { MOST = 1 << 20, SAMPLES = 1 << 17, LETTERS = 32, FAR = 1000000 };
enum { FORMAT, NOTE, ENDS, Q, L, BASE, LIMITS, SOS, K, TS, CUT, GAIN, ORDER, REST, FIRST, KEYS };
static const char *const NAMES[KEYS] = {"format", "note", "ends", "Q", "L", "base", "actuators",
    "sections", "coefficients", "Ts", "cutoff", "step", "order", "rest", "first"};
static const double PI = 3.14159265358979323846, ROUNDING = 4e-15;
static double scalar[KEYS] = {[GAIN] = 1, [FIRST] = 1}, sos[300], taps[MOST];
static double made[SAMPLES], v[SAMPLES], e[SAMPLES], once[2 * SAMPLES];
static int sizes[KEYS][3], of_L, format;  /* of arrays; keys of L; the number of the format */
static char text[1 << 24], *at = text, word[LETTERS];  /* the file, where the reader is, a string */

static int next(char mark)
{
    at += strspn(at, " \t\r\n");
    return *at == mark ? at++, 1 : 0;
}

static void need(char mark) { if (!next(mark)) DAMAGED("a mark is missing, or another one"); }

/* A string, of which the first letters are kept; what is not ASCII must be UTF-8. */
static void string(void)
{
    int n = 0;
    for (need('"'); *at != '"'; n += n < LETTERS - 1) {
        unsigned char c = word[n] = *at++;
        int more = (c >= 0xc2) + (c >= 0xe0) + (c >= 0xf0);
        long code = c & 0x3f >> more, least[] = {c > 127 ? 1L << 22 : 0, 0xa1, 0x800, 0x10000};
        if (c < ' ' || c == 127 || (c == '\\' && (!*at || !strchr("n\"\\", *at++))))
            DAMAGED("a string breaks off, or is not printable, or has an unknown escape");
        for (int k = 0; k < more && (*at & 0xc0) == 0x80; k++) code = code << 6 | (*at++ & 0x3f);
        if (c > 0xf4 || code < least[more] || code > 0x10ffff || code >> 11 == 0x1b)
            DAMAGED("a string is not UTF-8, or not printable");
    }
    word[n] = 0, at++;
}

/* A number as JSON writes it. */
static double number(int whole)
{
    char *start = at += strspn(at, " \t\r\n"), *digit = start + (*start == '-');
    size_t digits = strspn(digit, "0123456789"), all = strspn(start, "+-.0123456789eE");
    char *point = digit + digits;
    double x = strtod(start, &at);
    if (!digits || at != start + all || (*digit == '0' && digits > 1)
        || (*point == '.' && !strspn(point + 1, "0123456789"))) DAMAGED("a number is torn");
    if (!isfinite(x) || (at == point ? digits > 17 : whole)) DAMAGED("a number does not fit");
    return x;
}

/* An array with so many axes: how many numbers, and its sizes; all rows are equally long. */
static int array(double *x, int room, int axes, int *size)
{
    int count = 0, rows = 0;
    if (!room) DAMAGED("an array does not fit");
    if (!axes) return *x = number(0), 1;
    need('[');
    do count += array(x + count, room - count, axes - 1, size + 1), rows++; while (next(','));
    need(']');
    if (*size && *size != rows) DAMAGED("an array has rows of different lengths");
    return *size = rows, count;
}

/* An object with all of these keys and, if need be, others, as bits; which it has. */
static int object(int all, int others)
{
    int seen = 0, key;
    need('{');
    do {
        for (string(), key = 0; key < KEYS && strcmp(word, NAMES[key]); key++);
        if (!((all | others) & ~seen & 1 << key)) DAMAGED("a key is unknown here, or stands twice");
        seen |= 1 << key;
        need(':');
        if (key <= ENDS) string();
        if (key == FORMAT) format = strncmp(word, "rodlib law ", 11) ? 0 : word[11] - '0';
        if (key == FORMAT && format == 4 && !word[12])
            DAMAGED("limits of outputs need the model of the plant: learn by ilctools");
        if (key == FORMAT && (format < 1 || format > 3 || word[12])) DAMAGED("unknown format");
        if (key == ENDS && strcmp(word, "zero"))
            DAMAGED("ends must be zero; of a model, synthesise with reach");
        if (key == Q) object(1 << ORDER | 1 << CUT | 1 << ENDS, 0);
        if (key == L) of_L = object(1 << K | 1 << ENDS, 1 << FIRST | 1 << BASE);
        if (key == SOS) array(sos, sizeof sos / sizeof *sos, 2, sizes[key]);
        if (key == K) array(taps, MOST, 3, sizes[key]);
        if (key == BASE && strncmp(at += strspn(at, " \t\r\n"), "null", 4))
            DAMAGED("the base is a model; synthesise with reach");
        if (key == BASE) at += 4;
        if (key == LIMITS && !(next('{') && next('}'))) DAMAGED("there must be no limits");
        if (key >= TS) scalar[key] = number(key >= ORDER);
        if (key < ORDER ? key >= TS && scalar[key] <= 0 : fabs(scalar[key]) > FAR)
            DAMAGED("a number is out of its range");
    } while (next(','));
    need('}');
    if (all & ~seen) DAMAGED("a key is missing");
    return seen;
}

/* Samples until Q has decayed, whose sections c^2 (1 + q)^2 / (d + 2 (c^2 - 1) q + (d - 2 b) q^2)
   with c = tan(cutoff Ts / 2), b = 2 c sin(angle), d = 1 + b + c^2 must be those of the file. */
static double decay(void)
{
    int order = (int)scalar[ORDER], count = (order + 1) / 2, odd = order % 2;
    double c = tan(scalar[CUT] * scalar[TS] / 2), cc = c * c, gain = 1, radius = 0;
    if (!(c > 0 && scalar[CUT] < PI / scalar[TS] && order * log(4 + 4 * c) < 700))
        REFUSE("the cut-off is too near to the Nyquist frequency, or beyond it");
    if (sizes[SOS][0] != count || sizes[SOS][1] != 6) REFUSE("sections do not fit the order");
    for (int k = 1, s = count - 1; s >= 0; s--, k += 2) {  /* the last is next to the circle */
        double b = 2 * c * sin(PI * k / (2 * order)), d = k == order ? 1 + c : 1 + b + cc;
        double a1 = (k == order ? c - 1 : 2 * cc - 2) / d, a2 = k == order ? 0 : (1 - b + cc) / d;
        int zero = odd && (a1 < 1 || !s);  /* at 0 next to poles, if the order is odd */
        gain *= (k == order ? c : cc) / d, odd -= zero;
        double g = s ? 1 : gain, own[] = {g, (2 - zero) * g, (1 - zero) * g, 1, a1, a2};
        for (int j = 0; j < 6; j++)
            if (!(fabs(sos[6 * s + j] - own[j]) <= ROUNDING * (j < 3 ? order * own[j] : 1)))
                REFUSE("sections are not those of Q");
        radius = fmax(radius, k == order ? fabs(a1) : sqrt(a2));
    }
    return ceil(log(1e-18) / log(radius));
}

/* made = L e of n samples, by the taps of L from q^first on; beyond the ends zero. */
static void look(int first, int n)
{
    int m = sizes[K][0], errors = sizes[K][1], order = sizes[K][2];
    for (int row = 0; row < n * m; row++) {
        double sum = 0;
        for (int j = 0; j < errors; j++)
            for (int k = 0; k < order; k++) {
                int p = row / m + first + k;
                const double *tap = &taps[(row % m * errors + j) * order + k];
                if (p >= 0 && p < n) sum += *tap * e[p * errors + j];
            }
        made[row] = sum;
    }
}

int main(int argc, char **argv)
{
    FILE *file = argc == 2 || argc == 3 ? fopen(argv[1], "rb") : NULL;
    size_t length = file ? fread(text, 1, sizeof text - 1, file) : 0;
    if (!length || getc(file) != EOF) REFUSE("name a file of save_law, of less than 16 MB");
    object(1 << FORMAT | 1 << TS | 1 << Q | 1 << L | 1 << NOTE | 1 << SOS,
        1 << REST | 1 << GAIN | 1 << LIMITS);
    if (!next(0) || at != text + length + 1) DAMAGED("something follows the closing brace");
    int m = sizes[K][0], errors = sizes[K][1], all = m + errors, n = 0, rest = (int)scalar[REST];
    int both = 1 << FIRST | 1 << BASE, has = of_L & both;
    double gain = scalar[GAIN], reach = decay();
    if ((errors == m) != (format < 3)) REFUSE("format 3 has other numbers of v than of e");
    if (has != (format == 2 || (format == 3 && has) ? both : 0))
        REFUSE("first and base are keys of format 2");
    if (rest < 0 || gain > 1) REFUSE("rest or step is out of its range");
    for (; fgets(at = text, sizeof text, stdin); n++) {
        int fits = (n + 1) * all <= SAMPLES && !strpbrk(text, "xX");
        for (int i = 0; fits && i < all; i++) {
            char *start = at;
            double x = *(i < m ? &v[n * m + i] : &e[n * errors + i - m]) = strtod(start, &at);
            fits = at != start && isfinite(x) && strchr(" \t\r\n", *at);
        }
        if (!fits || at[strspn(at, " \t\r")] != '\n')
            REFUSE("line %d is no %d numbers, torn, or beyond what fits", n + 1, all);
    }
    if (ferror(stdin) || n <= rest || (argc == 3 && n != atoi(argv[2])))
        REFUSE("the trial has %d samples, the rest %d", n, rest);
    if (!(reach >= 0 && n + reach <= 2 * SAMPLES)) REFUSE("trial too long, or cut-off too low");
    int tail = (int)reach;  /* until the response beyond the end has decayed to rounding */
    look((int)scalar[FIRST], n);
    for (int i = 0; i < m; i++) {
        memset(once, 0, sizeof once);
        for (int p = 0; p < n; p++) once[p] = v[p * m + i] + made[p * m + i];
        for (int backward = 0; backward < 2; backward++) {
            double held = backward ? once[n + tail - 1] : 0;  /* before it begins */
            for (const double *c = sos; c < sos + 6 * sizes[SOS][0]; c += 6) {
                double rises = (c[0] + c[1] + c[2]) / (c[3] + c[4] + c[5]);
                double z0 = held * (rises - c[0]), z1 = held * (c[2] - rises * c[5]);
                for (int p = 0; p < n + tail; p++) {
                    double *at = once + (backward ? n + tail - 1 - p : p), x = *at;
                    *at = c[0] * x + z0;
                    z0 = c[1] * x - c[4] * *at + z1;
                    z1 = c[2] * x - c[5] * *at;
                }
                held *= rises;
            }
        }
        for (int p = 0; p < n; p++)
            v[p * m + i] = p < n - rest ? (1 - gain) * v[p * m + i] + gain * once[p] : 0;
    }
    for (int p = 0; p < n * m; p++)  /* all of it before a part is printed: it moves actuators */
        if (!isfinite(v[p]))
            REFUSE("the next v is not finite in line %d: v or e is too large", p / m + 1);
    for (int p = 0; p < n * m; p++) printf("%.17g%c", v[p], p % m == m - 1 ? '\n' : ' ');
    if (fflush(stdout) || ferror(stdout)) REFUSE("the next v was not written as a whole");
    return 0;
}
