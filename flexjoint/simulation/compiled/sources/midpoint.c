/* A step of linearly implicit midpoint: passes until the midpoint is the one that was predicted, and end
   velocities that are put right. It follows `Midpoint.step` of flexjoint/simulation/schemes/midpoint.py line
   by line, whose numbers are FJ_MISSED, FJ_STAYS, FJ_LEAST, FJ_REPEATS and FJ_GROWS. Of several rollouts each
   takes the passes that it would take alone: what the others repeat is made beside its own and not taken.

   Above: lanes.c, and generated fj_pass (x, tau_m, c, t, way, guess -> state row; v_mid and work), fj_totals
   (q, v, c -> totals), fj_right (before, after, q, passed, end, work, c -> end velocity and whether it is
   sound), FJ_TOTALS, FJ_TURNING, the first
   velocity that counts, FJ_FREE, whether what flies freely is to keep its momentum, FJ_ACC, the place of the
   accelerations in a state row, FJ_ALONE, whether one pass is a step, and the sizes FJ_STEP_*. */

#include <string.h>

/* How far a midpoint velocity is from its guess; scale: what that has to be compared with. */
static fj_real fj_missed_by(const fj_real *v_mid, const fj_real *guess, fj_real *scale) {
  fj_real error = fj_all(0.0), most = fj_all(FJ_LEAST);
  int i;
  for (i = FJ_TURNING; i < FJ_NV; i++) {
    fj_real off = fj_abs(v_mid[i] - guess[i]), speed = fj_abs(v_mid[i]);
    error = fj_pick(off <= error, error, off); /* what is not a number stays, and has missed */
    most = fj_pick(speed > most, speed, most);
  }
  *scale = most;
  return error;
}

static void fj_take(fj_mask mask, const fj_real *from, int count, fj_real *to) {
  int i;
  for (i = 0; i < count; i++) to[i] = fj_pick(mask, from[i], to[i]);
}

/* Puts right the end of a pass, the state row next, where `wanted`. Returns where it is sound. */
static fj_mask fj_put_right(const fj_real **given, fj_mask wanted, const fj_real *v_mid, fj_real *next,
                            fj_real *work) {
  const fj_real *arg[FJ_STEP_ARG], *x = given[0];
  fj_real *res[FJ_STEP_RES], before[FJ_TOTALS], after[FJ_TOTALS], passed[FJ_NV + 1], right[FJ_NV + 1];
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
  for (i = 0; i < FJ_NV; i++) next[FJ_NQ + i] = fj_pick(wanted, right[i], next[FJ_NQ + i]);
  return right[FJ_NV] != 0.0;
}

/* As a generated step: arg = {x, tau_m, c, t}, res = {state row}. Returns 0, or less the sum of 2^lane of
   those whose step is of order 1. */
static int fj_step(const fj_real **given, fj_real **result, long long *integers, fj_real *work, int memory) {
  const fj_real *arg[FJ_STEP_ARG], *x = given[0], *v = x + FJ_NQ, *acc = x + FJ_ACC;
  fj_real *next = result[0], *res[FJ_STEP_RES], guess[FJ_NV + 1], v_mid[FJ_NV + 1];
  fj_real again[FJ_NX], again_mid[FJ_NV + 1], error, missed, scale, its_scale, before;
  fj_mask repeated, active, good, right, last;
  int round, i, lane, lanes = 0;
  (void)integers;
  (void)memory;
  memcpy(arg, given, 4 * sizeof(fj_real *));
  for (i = 0; i < FJ_NV; i++) guess[i] = v[i] + FJ_HALF * acc[i];
  arg[4] = v;
  arg[5] = guess;
  res[0] = next;
  res[1] = v_mid;
  fj_pass(arg, res, 0, work, 0);
  if (FJ_ALONE) return 0;
  error = fj_missed_by(v_mid, guess, &scale);
  repeated = active = FJ_NOT(error <= FJ_MISSED * scale);
  arg[4] = guess;
  res[0] = again;
  res[1] = again_mid;
  for (round = 0; fj_any(active) && round < FJ_REPEATS; round++) {
    before = error;
    memcpy(guess, v_mid, FJ_NV * sizeof(fj_real));
    fj_pass(arg, res, 0, work, 0);
    fj_take(active, again, FJ_NX, next);
    fj_take(active, again_mid, FJ_NV + 1, v_mid);
    missed = fj_missed_by(v_mid, guess, &its_scale);
    error = fj_pick(active, missed, error);
    scale = fj_pick(active, its_scale, scale);
    active &= FJ_NOT(error <= FJ_STAYS * scale) & (error <= FJ_GROWS * before);
  }
  good = error <= FJ_MISSED * scale;
  right = FJ_FREE ? good : good & repeated;
  last = FJ_NOT(good);
  if (fj_any(right)) last |= right & FJ_NOT(fj_put_right(given, right, v_mid, next, work));
  if (fj_any(last)) {
    memset(guess, 0, sizeof guess);
    fj_pass(arg, res, 0, work, 0);
    fj_take(last, again, FJ_NX, next);
    fj_take(last, again_mid, FJ_NV + 1, v_mid);
    fj_put_right(given, last, v_mid, next, work);
    for (lane = 0; lane < FJ_LANES; lane++) lanes |= FJ_HAS(last, lane) << lane;
  }
  return -lanes;
}
