/* A function made from expressions, with its arguments, results and working memory. */
struct kernel {
    int (*function)(const double **arguments, double **results, long long *integers, double *numbers, int memory);
    const double **arguments;
    double **results;
    long long *integers;
    double *numbers;
};

static void run(const struct kernel *kernel) {
    kernel->function(kernel->arguments, kernel->results, kernel->integers, kernel->numbers, 0);
}
