/* The next trial's signal in C99, for a target without Python: v_{k+1} = Q (v_k + L e_k), (23).

   It reads a file of ilctools.save_law and, from the standard input, a line for each sample of the
   trial with v and e of all channels; it prints the next v, a line for each sample. Of a trial that
   breaks off, or is no number somewhere, it prints nothing; how many samples a whole one has, only
   who calls it knows, and may say.

       cc -std=c99 -O2 -ffp-contract=off law.c -lm -o law  &&  ./law law.json 2500 < trial > next

   For `ends` "zero" and without limits, as save_law writes them by default. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MOST = 1 << 20, SAMPLES = 1 << 17 };
static double sections[MOST], K[MOST], B[MOST], heard[SAMPLES], made[SAMPLES], v[SAMPLES], e[SAMPLES], once[2 * SAMPLES];

/* The numbers of the array, or the one number, behind a name in JSON; 0 if the name is not there. */
static int numbers(const char *text, const char *name, double *x, int *rows)
{
    char *at = strstr(text, name);
    int count = 0, depth = 0;
    if (!at) return 0;
    at = strchr(at, ':') + 1;
    do {
        while (*at && !strchr("[]-0123456789", *at)) at++;
        if (*at == '[') *rows += depth++ == 1, at++;
        else if (*at == ']') depth--, at++;
        else x[count++] = strtod(at, &at);
    } while (depth > 0 && count < MOST);
    return count;
}

/* out = L in of n samples of m channels, by the taps of L from q^first on; beyond the ends zero. */
static void look(const double *L, int order, int first, const double *in, double *out, int n, int m)
{
    for (int p = 0; p < n; p++)
        for (int i = 0; i < m; i++) {
            double sum = 0;
            for (int j = 0; j < m; j++)
                for (int k = 0; k < order; k++) {
                    int at = p + first + k;
                    if (at >= 0 && at < n) sum += L[(i * m + j) * order + k] * in[at * m + j];
                }
            out[p * m + i] = sum;
        }
}

int main(int argc, char **argv)
{
    static char text[1 << 24];
    FILE *file = argc == 2 || argc == 3 ? fopen(argv[1], "r") : NULL;
    if (!file || !fread(text, 1, sizeof text - 1, file))
        return fprintf(stderr, "law: name a file of save_law\n"), 1;
    if (!strstr(text, "\"rodlib law 1\"") && !strstr(text, "\"rodlib law 2\""))
        return fprintf(stderr, "law: this is no format that is known here\n"), 1;
    if (strstr(text, "\"scale\""))
        return fprintf(stderr, "law: the base is a model; synthesise with reach\n"), 1;
    if (strstr(text, "\"hold") || strstr(text, "\"actuators\""))
        return fprintf(stderr, "law: ends must be zero, and there must be no limits\n"), 1;

    int m = 0, stages = 0, unused = 0, n = 0, tail = 0;
    double rest = 0, gain = 1, radius = 0, first = 1, from = 0;
    int order = numbers(text, "\"coefficients\"", K, &m), taps = numbers(text, "\"taps\"", B, &unused);
    numbers(text, "\"sections\"", sections, &stages);
    numbers(text, "\"rest\"", &rest, &unused);
    numbers(text, "\"step\"", &gain, &unused);
    numbers(text, "\"first\"", &first, &unused);
    numbers(text, "\"from\"", &from, &unused);
    order /= m * m, taps /= m * m;
    for (int s = 0; s < stages; s++) {  /* until the tail beyond the end has decayed to rounding */
        double a1 = sections[6 * s + 4], a2 = sections[6 * s + 5];
        radius = fmax(radius, a2 > 0 ? sqrt(a2) : fabs(a1));
    }
    tail = (int)ceil(log(1e-18) / log(radius));
    int i = 0;
    for (double x; n + m <= SAMPLES && scanf("%lf", &x) == 1 && isfinite(x);) {
        *(i < m ? &v[n + i] : &e[n + i - m]) = x;
        if (++i == 2 * m) i = 0, n += m;
    }
    n /= m;
    if (i || !feof(stdin))
        return fprintf(stderr, "law: line %d is no %d numbers, or beyond what fits\n", n + 1, 2 * m), 1;
    if (!n || (argc == 3 && n != atoi(argv[2])))
        return fprintf(stderr, "law: the trial has %d samples\n", n), 1;
    if (n + tail > 2 * SAMPLES) return fprintf(stderr, "law: the trial is too long\n"), 1;

    look(K, order, (int)first, e, heard, n, m);  /* L e, or B K e */
    if (taps) look(B, taps, (int)from, heard, made, n, m);
    else memcpy(made, heard, sizeof made);
    for (int i = 0; i < m; i++) {
        memset(once, 0, sizeof once);
        for (int p = 0; p < n; p++) once[p] = v[p * m + i] + made[p * m + i];
        for (int backward = 0; backward < 2; backward++) {
            double held = backward ? once[n + tail - 1] : 0;  /* before it begins */
            for (int s = 0; s < stages; s++) {
                const double *c = sections + 6 * s;
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
            v[p * m + i] = p < n - (int)rest ? (1 - gain) * v[p * m + i] + gain * once[p] : 0;
    }
    for (int p = 0; p < n * m; p++) printf("%.17g%c", v[p], p % m == m - 1 ? '\n' : ' ');
    return 0;
}
