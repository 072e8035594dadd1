from statechart.palette import state_colours


def test_modes_of_contacts_keep_their_colours_and_other_states_have_none_of_these():
    contact = state_colours(("free", "slide+", "slide-", "pin", "off"))
    assert state_colours(("pin", "free")) == {s: contact[s] for s in ("pin", "free")}
    controller = state_colours(("swing", "compress", "thrust", "rest", "a", "b", "c", "d"))
    assert len(set(controller.values())) == len(controller)
    assert not set(controller.values()) & set(contact.values())


def test_an_unnamed_state_takes_the_first_free_colour():
    assert state_colours(("free", "wait"))["wait"] == state_colours(("wait",))["wait"]
