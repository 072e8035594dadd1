"""Impact laws.

`impact` solves one contact (Routh's path; Stronge, Newton, Poisson), `impulses` several contacts as
a complementarity problem; `simultaneous` combines them. `jamming` detects Painleve's paradoxes and
resolves them by an impact without collision. `bounces` sums accumulating impacts (Zeno) and
passages through a corner.
"""
