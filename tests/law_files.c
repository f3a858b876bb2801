/* docs/law.c on FOLDER/0, FOLDER/1, ... in a process each, with the trial FOLDER/trial: what each
   prints, and "=". It ends with an error if one does not end by itself, with 0 or 1.

       law_files FOLDER COUNT                                                                    */
#define main law
#include "../docs/law.c"
#undef main
#include <sys/wait.h>
#include <unistd.h>

const char *__asan_default_options(void) { return "abort_on_error=1:detect_leaks=0"; }
const char *__ubsan_default_options(void) { return "abort_on_error=1"; }

int main(int argc, char **argv)
{
    char path[4096];
    for (int k = 0; argc == 3 && k < atoi(argv[2]); k++) {
        int status;
        fflush(stdout);
        if (!fork()) {
            snprintf(path, sizeof path, "%s/trial", argv[1]);
            if (!freopen(path, "r", stdin)) return 2;
            snprintf(path, sizeof path, "%s/%d", argv[1], k);
            exit(law(2, (char *[]){argv[0], path}));
        }
        wait(&status);
        if (!WIFEXITED(status) || WEXITSTATUS(status) > 1) return 1;
        printf("=");
    }
    return 0;
}
