"""Laws of impact.

`impact` is one contact (Routh's `path`; Stronge, Newton, Poisson), `impulses` are several as a
complementarity problem, `simultaneous` combines them, `work` bounds their energy. `jamming` is an
impact without collision, `bounces` the sum of those that accumulate.
"""
