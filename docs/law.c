/* The next trial's signal in C99, for a target without Python: v_{k+1} = Q (v_k + L e_k), (23).

   It reads a file of ilctools.save_law and, from the standard input, a line for each sample of the
   trial with v and e of all channels; it prints the next v, a line for each sample.

       cc -std=c99 -O2 -ffp-contract=off law.c -lm -o law  &&  ./law law.json < trial > next

   For `ends` "zero" and without limits, as save_law writes them by default. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MOST = 1 << 16, SAMPLES = 1 << 17 };
static double sections[MOST], L[MOST], v[SAMPLES], e[SAMPLES], once[2 * SAMPLES];

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

int main(int argc, char **argv)
{
    static char text[1 << 22];
    FILE *file = argc == 2 ? fopen(argv[1], "r") : NULL;
    if (!file || !fread(text, 1, sizeof text - 1, file))
        return fprintf(stderr, "law: name a file of save_law\n"), 1;
    if (strstr(text, "\"hold") || strstr(text, "\"actuators\""))
        return fprintf(stderr, "law: ends must be zero, and there must be no limits\n"), 1;

    int m = 0, stages = 0, unused = 0, n = 0, tail = 0;
    double rest = 0, gain = 1, radius = 0;
    int order = numbers(text, "\"coefficients\"", L, &m);
    numbers(text, "\"sections\"", sections, &stages);
    numbers(text, "\"rest\"", &rest, &unused);
    numbers(text, "\"step\"", &gain, &unused);
    order /= m * m;
    for (int s = 0; s < stages; s++) {  /* until the tail beyond the end has decayed to rounding */
        double a1 = sections[6 * s + 4], a2 = sections[6 * s + 5];
        radius = fmax(radius, a2 > 0 ? sqrt(a2) : fabs(a1));
    }
    tail = (int)ceil(log(1e-18) / log(radius));
    for (int i = 0; n + m <= SAMPLES && scanf("%lf", i < m ? &v[n + i] : &e[n + i - m]) == 1;)
        if (++i == 2 * m) i = 0, n += m;
    n /= m;
    if (n + tail > 2 * SAMPLES) return fprintf(stderr, "law: the trial is too long\n"), 1;

    for (int i = 0; i < m; i++) {
        memset(once, 0, sizeof once);
        for (int p = 0; p < n; p++) {  /* v + L e, where L looks ahead */
            double ahead = 0;
            for (int j = 0; j < m; j++)
                for (int k = 1; k <= order && p + k < n; k++)
                    ahead += L[(i * m + j) * order + k - 1] * e[(p + k) * m + j];
            once[p] = v[p * m + i] + ahead;
        }
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
