"""Contact rows for tests of the solvers."""

from __future__ import annotations

from contacts.solvers.contact_rows import ContactRows, write_diagonal_blocks
from statechart.arrays import Array, Ints


def contact_rows(
    bodies: Ints, moving: int, rows: Array, columns: Array, cones: Array
) -> ContactRows:
    """Return contacts of `moving` bodies, with derived numbers."""
    contacts = ContactRows.allocate(len(bodies), moving)._replace(
        bodies=bodies, moving=moving, rows=rows, columns=columns, cones=cones
    )
    write_diagonal_blocks(contacts)
    return contacts
