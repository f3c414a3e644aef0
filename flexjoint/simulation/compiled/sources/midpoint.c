/* A step of linearly implicit midpoint: passes until the midpoint is the one that was predicted, and end
   velocities that are put right. It follows `Midpoint.step` of flexjoint/simulation/schemes/midpoint.py line
   by line, whose numbers are FJ_MISSED, FJ_STAYS, FJ_LEAST, FJ_REPEATS and FJ_GROWS.

   Generated above: fj_pass (x, tau_m, c, t, way, guess -> state row; v_mid and work), fj_totals (q, v, c ->
   totals), fj_right (before, after, q, passed, end, work, c -> end velocity and whether it is
   sound), FJ_TOTALS, FJ_TURNING, the first
   velocity that counts, FJ_FREE, whether what flies freely is to keep its momentum, FJ_ACC, the place of the
   accelerations in a state row, FJ_ALONE, whether one pass is a step, and the sizes FJ_STEP_*. */

#include <math.h>
#include <string.h>

/* How far a midpoint velocity is from its guess; scale: what that has to be compared with. */
static double fj_missed_by(const double *v_mid, const double *guess, double *scale) {
  double error = 0.0;
  int i;
  *scale = FJ_LEAST;
  for (i = FJ_TURNING; i < FJ_NV; i++) {
    double off = fabs(v_mid[i] - guess[i]), speed = fabs(v_mid[i]);
    if (!(off <= error)) error = off; /* what is not a number stays, and has missed */
    if (speed > *scale) *scale = speed;
  }
  return error;
}

/* Puts right the end of a pass, the state row next. Returns whether it is sound. */
static int fj_put_right(const double **given, const double *v_mid, double *next, double *work) {
  const double *arg[FJ_STEP_ARG], *x = given[0];
  double *res[FJ_STEP_RES], before[FJ_TOTALS], after[FJ_TOTALS], passed[FJ_NV + 1], right[FJ_NV + 1];
  int i;
  for (i = 0; i < FJ_NV; i++) passed[i] = 2.0 * v_mid[i] - x[FJ_NQ + i];
  arg[0] = x;
  arg[1] = x + FJ_NQ;
  arg[2] = given[2];
  res[0] = before;
  fj_totals(arg, res, 0, work, 0);
  arg[0] = next;
  arg[1] = passed;
  res[0] = after;
  fj_totals(arg, res, 0, work, 0);
  arg[0] = before;
  arg[1] = after;
  arg[2] = next;
  arg[3] = passed;
  arg[4] = next + FJ_NQ;
  arg[5] = v_mid + FJ_NV;
  arg[6] = given[2];
  res[0] = right;
  fj_right(arg, res, 0, work, 0);
  memcpy(next + FJ_NQ, right, FJ_NV * sizeof(double));
  return right[FJ_NV] != 0.0;
}

/* As a generated step: arg = {x, tau_m, c, t}, res = {state row}. Returns 0. */
static int fj_step(const double **given, double **result, long long *integers, double *work, int memory) {
  const double *arg[FJ_STEP_ARG], *x = given[0], *v = x + FJ_NQ, *acc = x + FJ_ACC;
  double *res[FJ_STEP_RES], guess[FJ_NV + 1], v_mid[FJ_NV + 1], error, scale, before;
  int repeated, round, i;
  (void)integers;
  (void)memory;
  memcpy(arg, given, 4 * sizeof(double *));
  for (i = 0; i < FJ_NV; i++) guess[i] = v[i] + FJ_HALF * acc[i];
  arg[4] = v;
  arg[5] = guess;
  res[0] = result[0];
  res[1] = v_mid;
  fj_pass(arg, res, 0, work, 0);
  if (FJ_ALONE) return 0;
  error = fj_missed_by(v_mid, guess, &scale);
  repeated = !(error <= FJ_MISSED * scale);
  arg[4] = guess;
  for (round = 0; repeated && round < FJ_REPEATS; round++) {
    before = error;
    memcpy(guess, v_mid, FJ_NV * sizeof(double));
    fj_pass(arg, res, 0, work, 0);
    error = fj_missed_by(v_mid, guess, &scale);
    if (error <= FJ_STAYS * scale || !(error <= FJ_GROWS * before)) break;
  }
  if (error <= FJ_MISSED * scale) {
    if (!repeated && !FJ_FREE) return 0;
    if (fj_put_right(given, v_mid, result[0], work)) return 0;
  }
  memset(guess, 0, FJ_NV * sizeof(double));
  fj_pass(arg, res, 0, work, 0);
  fj_put_right(given, v_mid, result[0], work);
  return 0;
}
