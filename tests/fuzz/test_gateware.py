"""A bounded run of the fuzzer of the gateware; ``make fuzz`` goes on for longer."""

import pytest

from tests.fuzz.gateware import Model, fuzz, stream


@pytest.mark.parametrize("seed", range(3))
def test_the_card_answers_what_its_model_does(seed):
    session = fuzz(seed, 25)
    assert session.commands > 200
    assert session.model.damaged > 50


def test_a_card_that_answered_a_damaged_command_would_be_found(monkeypatch):
    monkeypatch.setattr(Model, "answers", lambda self, data: [])
    with pytest.raises(AssertionError, match="seed 5, batch 0"):
        fuzz(5, 1)


def test_the_streams_have_damage_in_them():
    import random

    model = Model()
    answers = model.answers(stream(random.Random(1), 300))
    assert len(answers) > 100
    assert model.damaged > 50
