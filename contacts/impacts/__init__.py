"""Laws of impact.

`impact` is one contact (Routh's path; Stronge, Newton, Poisson), `impulses` several as a
complementarity problem, `plastic` the kernel of its unambiguous cases; `simultaneous` combines
them. `jamming` is an impact without collision, `bounces` the sum of those that accumulate.
"""
