/* What depends on parameters alone, once per run: constants (FJ_NC) of the parameters (FJ_NP), by the
   generated fj_setup. */
FJ_EXPORT void flexjoint_setup(const fj_real *parameters, fj_real *constants) {
  const fj_real *arg[1];
  fj_real *res[1];
  arg[0] = parameters;
  res[0] = constants;
  fj_setup(arg, res, 0, 0, 0);
}
