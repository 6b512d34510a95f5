// Solves one symmetric positive definite system with SuiteSparse's CHOLMOD, and times the parts.
//
// usage: peer-cholmod MATRIX.mtx RIGHT_SIDE.mtx [REPEATS]
//
// The matrix is MatrixMarket, `coordinate real symmetric` (the lower triangle); the right side is
// `array real general` with one column. As Ceres has it: AMD, postordered, and CHOLMOD's own choice
// between supernodal and simplicial. For one thread set OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1.
//
// Prints one line of JSON: medians of 20 runs in milliseconds of the analysis (ordering and symbolic
// factorization), the numeric factorization and the solution, the factor's size, and how far the
// solution is off, as |A x - b| / (|A| |x| + |b|) in the largest norm.
#include <cholmod.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <vector>

namespace {

double now_ms() {
  const auto since = std::chrono::steady_clock::now().time_since_epoch();
  return std::chrono::duration<double, std::milli>(since).count();
}

double median(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  const size_t middle = values.size() / 2;
  return values.size() % 2 ? values[middle] : 0.5 * (values[middle - 1] + values[middle]);
}

[[noreturn]] void fail(const char* what) {
  std::fprintf(stderr, "peer-cholmod: %s\n", what);
  std::exit(1);
}

FILE* open(const char* path) {
  FILE* file = std::fopen(path, "r");
  if (!file) fail(path);
  return file;
}

double backward_error(cholmod_sparse* a, cholmod_dense* x, cholmod_dense* b, cholmod_common* common) {
  double one[2] = {1.0, 0.0}, minus_one[2] = {-1.0, 0.0};
  cholmod_dense* off = cholmod_copy_dense(b, common);
  cholmod_sdmult(a, 0, one, minus_one, x, off, common);
  const double infinity = 0;  // CHOLMOD's number for that norm
  const double size = cholmod_norm_sparse(a, infinity, common) * cholmod_norm_dense(x, infinity, common) +
                      cholmod_norm_dense(b, infinity, common);
  const double error = cholmod_norm_dense(off, infinity, common) / size;
  cholmod_free_dense(&off, common);
  return error;
}

}  // namespace

int main(int count, char** arguments) {
  if (count < 3 || count > 4) fail("usage: peer-cholmod MATRIX.mtx RIGHT_SIDE.mtx [REPEATS]");
  const int repeats = count == 4 ? std::max(1, std::atoi(arguments[3])) : 20;
  cholmod_common common;
  cholmod_start(&common);
  common.supernodal = CHOLMOD_AUTO;
  common.nmethods = 1;
  common.method[0].ordering = CHOLMOD_AMD;
  common.postorder = 1;

  cholmod_sparse* a = cholmod_read_sparse(open(arguments[1]), &common);
  cholmod_dense* b = cholmod_read_dense(open(arguments[2]), &common);
  if (!a || a->stype == 0) fail("the matrix is not symmetric MatrixMarket");
  if (!b || b->nrow != a->nrow) fail("the right side does not fit");

  std::vector<double> analyze, factorize, solve, total;
  double error = 0.0, nonzeros = 0.0;
  bool supernodal = false;
  for (int run = 0; run < repeats; ++run) {
    const double begun = now_ms();
    cholmod_factor* factor = cholmod_analyze(a, &common);
    const double analyzed = now_ms();
    cholmod_factorize(a, factor, &common);
    const double factorized = now_ms();
    if (common.status != CHOLMOD_OK) fail("the matrix is not positive definite");
    cholmod_dense* x = cholmod_solve(CHOLMOD_A, factor, b, &common);
    const double solved = now_ms();
    analyze.push_back(analyzed - begun);
    factorize.push_back(factorized - analyzed);
    solve.push_back(solved - factorized);
    total.push_back(solved - begun);
    error = backward_error(a, x, b, &common);
    nonzeros = common.lnz;
    supernodal = factor->is_super;
    cholmod_free_dense(&x, &common);
    cholmod_free_factor(&factor, &common);
  }
  std::printf(
      "{\"peer\": \"CHOLMOD\", \"version\": \"%d.%d.%d\", \"rows\": %zu, \"factor_nnz\": %.0f, \"supernodal\": %s, "
      "\"runs\": %d, \"analyze_ms\": %.4f, \"factorize_ms\": %.4f, \"solve_ms\": %.4f, \"total_ms\": %.4f, "
      "\"backward_error\": %.3g}\n",
      CHOLMOD_MAIN_VERSION, CHOLMOD_SUB_VERSION, CHOLMOD_SUBSUB_VERSION, a->nrow, nonzeros,
      supernodal ? "true" : "false", repeats, median(analyze), median(factorize), median(solve), median(total), error);
  cholmod_free_sparse(&a, &common);
  cholmod_free_dense(&b, &common);
  cholmod_finish(&common);
}
