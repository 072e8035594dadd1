"""Laws of impact.

`impact` is one contact (Routh's `path`; Stronge, Newton, Poisson), `impulses` are several as a
complementarity problem, of which `plastic` solves the simple ones in compiled runs; `simultaneous`
combines them, `work` bounds their energy. `jamming` is an impact without collision, `bounces` the
sum of those that accumulate.
"""
