"""Choice of the compiled loop: cached on disk, or worth compiling."""

from statechart.execution.compiled_loop import _WORTH_COMPILING, _CompilationPolicy


def test_the_cache_is_checked_when_the_requests_have_doubled() -> None:
    looked: list[bool] = []

    def look() -> bool:
        looked.append(len(looked) > 5)
        return looked[-1]

    worth = _CompilationPolicy(look)
    assert [worth.pays() for _ in range(100)] == [False] * 63 + [True] * 37
    assert len(looked) == 7


def test_loop_is_compiled_after_enough_requests() -> None:
    worth = _CompilationPolicy(lambda: False)
    assert not worth.pays(_WORTH_COMPILING)
    assert worth.pays()
