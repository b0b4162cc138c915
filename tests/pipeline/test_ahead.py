"""What is made while something else is done."""

import threading

import pytest

from pipeline.ahead import begun, made_ahead


@pytest.mark.parametrize("items", [[], [None], [0, None, False, 3], list(range(100))])
def test_all_items_come_in_order(items):
    assert list(made_ahead(items)) == items


def test_the_next_item_is_made_while_one_is_used_and_no_more_than_that():
    made = [threading.Event() for _ in range(4)]

    def items():
        for number, event in enumerate(made):
            event.set()
            yield number

    for number in made_ahead(items()):
        if number < 3:
            assert made[number + 1].wait(timeout=60)
        assert not any(event.is_set() for event in made[number + 2 :])


def test_an_error_comes_in_its_place():
    def items():
        yield 1
        raise ValueError("damaged")

    stream = made_ahead(items())
    assert next(stream) == 1
    with pytest.raises(ValueError, match="damaged"):
        next(stream)
    assert list(stream) == []


def test_a_value_is_made_before_it_is_asked_for():
    made = threading.Event()

    def make():
        made.set()
        return 5

    value = begun(make)
    assert made.wait(timeout=60)
    assert (value(), value()) == (5, 5)


def test_the_error_of_a_value_comes_when_it_is_asked_for():
    def make():
        raise ValueError("damaged")

    value = begun(make)
    with pytest.raises(ValueError, match="damaged"):
        value()
