/* A step of implicit midpoint: Newton's method on the generated equations. It follows `_newton` of
   flexjoint/implicit.py line by line, whose numbers are FJ_ITERATIONS, FJ_CONVERGED, FJ_STALLED, FJ_SLOW,
   FJ_HALVINGS and FJ_NUDGE.

   Generated above: fj_guess (x, tau_m, c, t -> u), fj_missing (u, x, tau_m, c, t -> residual), fj_end
   (u, x, tau_m, c, t -> state row), FJ_UNKNOWNS and the sizes FJ_STEP_*. */

#include <math.h>
#include <string.h>

typedef struct {
  const double **arg; /* FJ_STEP_ARG; arg[1..4] are x, tau_m, c and t */
  double **res, *work;
  double *factors, *move, *moved; /* (n, n), (n,), (n,) */
  int pivots[FJ_UNKNOWNS + 1];
} fj_newton;

static void fj_missing_at(fj_newton *own, const double *u, double *residual) {
  own->arg[0] = u;
  own->res[0] = residual;
  fj_missing(own->arg, own->res, 0, own->work, 0);
}

/* Largest change relative to 1 + |u|; not a number where one is not. */
static double fj_size(const double *change, const double *u) {
  double largest = 0.0;
  int i;
  for (i = 0; i < FJ_UNKNOWNS; i++) {
    double size = fabs(change[i]) / (1.0 + fabs(u[i]));
    if (isnan(size)) return size;
    if (size > largest) largest = size;
  }
  return largest;
}

static int fj_worst(const double *residual, const double *u) {
  double largest = -1.0;
  int i, worst = 0;
  for (i = 0; i < FJ_UNKNOWNS; i++) {
    double size = fabs(residual[i]) / (1.0 + fabs(u[i]));
    if (isnan(size)) return i;
    if (size > largest) {
      largest = size;
      worst = i;
    }
  }
  return worst;
}

/* Difference quotients of the residual, as factors L U with row exchanges. Returns 0 where they are singular. */
static int fj_slopes(fj_newton *own, const double *u, const double *residual) {
  const int n = FJ_UNKNOWNS;
  double *a = own->factors, *column = own->move;
  int i, j, k;
  memcpy(own->moved, u, FJ_UNKNOWNS * sizeof(double));
  for (k = 0; k < n; k++) {
    own->moved[k] = u[k] + FJ_NUDGE * (1.0 + fabs(u[k]));
    fj_missing_at(own, own->moved, column);
    for (i = 0; i < n; i++) a[i * n + k] = (column[i] - residual[i]) / (own->moved[k] - u[k]);
    own->moved[k] = u[k];
  }
  for (k = 0; k < n; k++) {
    int pivot = k;
    for (i = k + 1; i < n; i++)
      if (fabs(a[i * n + k]) > fabs(a[pivot * n + k])) pivot = i;
    own->pivots[k] = pivot;
    if (a[pivot * n + k] == 0.0) return 0;
    if (pivot != k)
      for (j = 0; j < n; j++) {
        double held = a[k * n + j];
        a[k * n + j] = a[pivot * n + j];
        a[pivot * n + j] = held;
      }
    for (i = k + 1; i < n; i++) {
      double factor = a[i * n + k] /= a[k * n + k];
      if (factor != 0.0)
        for (j = k + 1; j < n; j++) a[i * n + j] -= factor * a[k * n + j];
    }
  }
  return 1;
}

/* move = -slopes^-1 residual */
static void fj_solve(const fj_newton *own, const double *residual, double *move) {
  const int n = FJ_UNKNOWNS;
  const double *a = own->factors;
  int i, j, k;
  for (i = 0; i < n; i++) move[i] = -residual[i];
  for (k = 0; k < n; k++) { /* rows were exchanged whole, so all exchanges come first */
    double held = move[k];
    move[k] = move[own->pivots[k]];
    move[own->pivots[k]] = held;
  }
  for (i = 0; i < n; i++)
    for (j = 0; j < i; j++) move[i] -= a[i * n + j] * move[j];
  for (i = n - 1; i >= 0; i--) {
    for (j = i + 1; j < n; j++) move[i] -= a[i * n + j] * move[j];
    move[i] /= a[i * n + i];
  }
}

static void fj_add(const double *u, double share, const double *move, double *sum) {
  int i;
  for (i = 0; i < FJ_UNKNOWNS; i++) sum[i] = u[i] + share * move[i];
}

/* The root in u, from the guess there. Returns 0, or 1 + the place of the worst residual. */
static int fj_root(fj_newton *own, double *u, double *residual, double *next, double *trial) {
  double before = INFINITY;
  int round, fresh = 1, i;
  fj_missing_at(own, u, residual);
  if (!fj_slopes(own, u, residual)) return 1 + fj_worst(residual, u);
  for (round = 0; round < FJ_ITERATIONS; round++) {
    double size, share = 1.0;
    fj_solve(own, residual, own->move);
    size = fj_size(own->move, u);
    if (!isfinite(size)) break;
    fj_add(u, 1.0, own->move, next);
    if (size <= FJ_CONVERGED || (size <= FJ_STALLED && size >= 0.5 * before)) {
      memcpy(u, next, FJ_UNKNOWNS * sizeof(double));
      return 0;
    }
    fj_missing_at(own, next, trial);
    if (fj_size(trial, u) > fj_size(residual, u)) {
      if (!fresh) {
        if (!fj_slopes(own, u, residual)) break;
        fresh = 1;
        before = INFINITY;
        continue;
      }
      for (i = 0; i < FJ_HALVINGS; i++) { /* a kink, or too far: go part of the way */
        share *= 0.5;
        fj_add(u, share, own->move, next);
        fj_missing_at(own, next, trial);
        if (fj_size(trial, u) <= fj_size(residual, u)) break;
      }
    }
    memcpy(u, next, FJ_UNKNOWNS * sizeof(double));
    memcpy(residual, trial, FJ_UNKNOWNS * sizeof(double));
    fresh = share < 1.0 || size > FJ_SLOW * before;
    if (fresh && !fj_slopes(own, u, residual)) break;
    before = size;
  }
  return 1 + fj_worst(residual, u);
}

/* As a generated step: arg = {x, tau_m, c, t}, res = {state row}. Returns 0, or 1 + the place of the worst
   unknown where Newton's method did not converge. */
static int fj_step(const double **given, double **result, long long *integers, double *work, int memory) {
  const double *arg[FJ_STEP_ARG];
  double *res[FJ_STEP_RES];
  double *u = work, *residual = u + FJ_UNKNOWNS, *next = residual + FJ_UNKNOWNS, *trial = next + FJ_UNKNOWNS;
  fj_newton own;
  int worst;
  (void)integers;
  (void)memory;
  own.arg = arg;
  own.res = res;
  own.move = trial + FJ_UNKNOWNS;
  own.moved = own.move + FJ_UNKNOWNS;
  own.factors = own.moved + FJ_UNKNOWNS;
  own.work = own.factors + FJ_UNKNOWNS * FJ_UNKNOWNS;
  memcpy(arg, given, 4 * sizeof(double *));
  res[0] = u;
  fj_guess(arg, res, 0, own.work, 0);
  memcpy(arg + 1, given, 4 * sizeof(double *));
  worst = fj_root(&own, u, residual, next, trial);
  if (worst) return worst;
  arg[0] = u;
  res[0] = result[0];
  fj_end(arg, res, 0, own.work, 0);
  return 0;
}
