/* The right-hand side of a model, by the generated fj_rates. */
FJ_EXPORT void flexjoint_rates(const double *x, const double *tau_m, const double *constants, double t,
                               double width, double *rates) {
  const double *arg[FJ_RATES_ARG];
  double *res[FJ_RATES_RES], work[FJ_RATES_W];
  arg[0] = x;
  arg[1] = tau_m;
  arg[2] = constants;
  arg[3] = &t;
  arg[4] = &width;
  res[0] = rates;
  fj_rates(arg, res, 0, work, 0);
}
