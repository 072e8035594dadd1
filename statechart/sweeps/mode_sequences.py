"""Sequences of modes as text: cycles contracted, long ones cut, and told apart in lists.

A stored sequence of more than MAX_LETTERS leaves out its middle, and ends with its length and a
digest of the whole: equal texts are equal sequences. People see where sequences differ instead.
"""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from collections.abc import Sequence
from itertools import accumulate, takewhile

MAX_LETTERS = 240
"""Length from which on the middle of a sequence is left out, and a cycle is not written whole."""
# Letters of the two ends of a longer one, of a text in a list, and modes of a cycle.
_BEGIN, _END, _LISTED, _MAX_PERIOD = 180, 50, 96, 12
# Modes of at least so many regions name only the regions that are not in their usual state.
_MANY_REGIONS = 4
_STATE = re.compile(r"([^\s():>]+):([^\s():>]+)")
_BETWEEN, _DIGEST = re.compile(r" > (?![^(]*\))"), re.compile(r" modes, [0-9a-f]{8}\)$")
_LENGTH = re.compile(r"\(\d+ modes\)$")


def write_sequence(words: Sequence[str]) -> str:
    """Return a sequence of modes as text; a long one by its ends, its length and a digest."""
    parts = contract_cycles(words)
    text = " > ".join(parts)
    if len(text) <= MAX_LETTERS:
        return text
    digest = hashlib.sha256(" > ".join(words).encode()).hexdigest()[:8]
    begin = parts[: max(_count(parts, _BEGIN), 1)]
    rest = parts[len(begin) :]
    end = rest[len(rest) - max(_count(rest[::-1], _END), 1) :] if rest else [words[-1]]
    # A contracted cycle may exceed MAX_LETTERS.
    begin = [words[0]] if len(begin[0]) > MAX_LETTERS else begin
    end = [words[-1]] if len(end[-1]) > MAX_LETTERS else end
    if [*begin, *end] == parts:
        return text
    return f"{' > '.join([*begin, '...', *end])} ({len(words)} modes, {digest})"


def _count(parts: Sequence[str], letters: int) -> int:
    """Return the number of parts from the first one that have these letters at most."""
    sums = accumulate(len(part) + 3 for part in parts)
    return sum(1 for _ in takewhile(lambda length: length <= letters, sums))


def contract_cycles(words: Sequence[str]) -> list[str]:
    """Return a sequence with repeated cycles contracted: ``(a > b) x 3``."""
    found: list[str] = []
    k = 0
    while k < len(words):
        best = (1, 1)
        for period in range(2, _MAX_PERIOD + 1):
            cycle, end = words[k : k + period], k + period
            while words[end : end + period] == cycle:
                end += period
            times = (end - k) // period
            if times > 1 and times * period > best[0] * best[1]:
                best = (period, times)
        period, times = best
        text = " > ".join(words[k : k + period])
        found.append(text if times == 1 else f"({text}) x {times}")
        k += period * times
    return found


def shorten_alike(texts: Sequence[str]) -> list[str]:
    """Return sequences of modes for a list, long ones reduced to their differences."""
    if max(map(len, texts), default=0) <= _LISTED:
        return list(texts)
    # Only the regions with a state that differs; a digest is unreadable.
    counts: dict[str, Counter[str]] = {}
    for region, state in _STATE.findall(" ".join(texts)):
        counts.setdefault(region, Counter())[state] += 1

    def short(word: str) -> str:
        states = _STATE.findall(word)
        if len(states) < _MANY_REGIONS:
            return word
        own = [s for s in states if s[1] != counts[s[0]].most_common(1)[0][0]] or states[:1]
        kept = _STATE.sub(lambda found: found[0] if found.groups() in own else "", word)
        return re.sub(" +", " ", kept).replace("( ", "(").replace(" )", ")").strip()

    # A cycle in parentheses is one word.
    split = [_BETWEEN.split(_DIGEST.sub(" modes)", text)) for text in texts]
    split = [[" > ".join(map(short, word.split(" > "))) for word in words] for words in split]
    found: list[str] = []
    seen: Counter[str] = Counter()
    for words in split:
        begin = max((_shared(words, other) for other in split if other is not words), default=0)
        cut = max(begin - 1, 0)
        after = words[cut + (cut > 1 and words[cut] == "...") :]
        text = " > ".join([*([words[0], "..."] if cut > 1 else words[:cut]), *after])
        length = _LENGTH.search(words[-1])
        end = f"... {length[0]}" if length else "..."
        if len(text) > _LISTED:
            text = f"{text[: _LISTED - len(end)].rpartition(' ')[0]} {end}"
        seen[text] += 1
        found.append(f"{text}, {seen[text]}" if seen[text] > 1 else text)
    return found


def _shared(one: Sequence[str], other: Sequence[str]) -> int:
    """Return the length of the common prefix of two sequences."""
    pairs = zip(one, other, strict=False)
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))
