"""heyoka's compiled steps, linked into a process."""

from __future__ import annotations

import subprocess
import sys

import pytest

# More than 2 GB of reserved addresses, with holes of a page at the end: there small sections find
# room, the code below.
SCRIPT = """
import ctypes
import heyoka as hy
from statechart.engines.taylor_loop import Step

PAGE, SIZE, PRIVATE, ANONYMOUS, NORESERVE = 4096, 6 << 30, 0x02, 0x20, 0x4000
libc = ctypes.CDLL(None)
libc.mmap.restype = ctypes.c_void_p
libc.mmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t, *[ctypes.c_int] * 3, ctypes.c_long]
libc.munmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t]

def reserve(size):
    return libc.mmap(None, size, 0, PRIVATE | ANONYMOUS | NORESERVE, -1, 0)

def fill(sizes, count):
    for pages in sizes:  # of holes, the largest first
        for _ in range(count):
            reserve(pages * PAGE)

x, v = hy.make_vars("x", "v")
integrator = hy.taylor_adaptive([(x, v), (v, -hy.sin(x))], [0.1, 0.0], compact_mode=False)
Step.of(integrator)
fill((256, 64, 16, 4, 2, 1), 1000)
end = reserve(SIZE) + SIZE
for k in range(1, 200):
    libc.munmap(end - 2 * k * PAGE, PAGE)
steps = []
for _ in range(50):
    fill((256, 64, 16, 4, 2), 20)  # holes that came since
    steps.append(Step.of(integrator))
print(all(step is not None for step in steps))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="reserves addresses as Linux does")
def test_steps_link_where_free_addresses_are_more_than_2_gb_apart():
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout) == (0, "True\n"), done.stderr
