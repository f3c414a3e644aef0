"""The study behind docs/studies/diagnosis_study.md: planted recordings by the thousand,
diagnosed and counted.

cases.py says what is planted, run.py diagnoses it into JSON lines, score.py judges one case, summary.py
counts, page.py writes the tables.
"""
