"""Rigid-body algorithms on numbers (Pinocchio) and on CasADi expressions."""
