"""Laws of impact.

`impact` is one contact (Routh's path; Stronge, Newton, Poisson), `impulses` several as a
complementarity problem; `simultaneous` combines them. `jamming` explains Painleve's paradoxes and
resolves them by an impact without collision, `bounces` sums those that accumulate and
passages through a corner.
"""
