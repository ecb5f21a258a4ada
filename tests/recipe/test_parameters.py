import json
import math

import pytest

from tnst_mi.errors import InputError
from tnst_mi.recipe.parameters import parameters
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.recipe.sections import KINDS

PARAMETERS = {each["key"]: each for each in parameters()}


def test_all_keys_are_there_as_json_holds_them():
    assert list(PARAMETERS) == list(KINDS)
    assert json.loads(json.dumps(parameters(), allow_nan=False)) == parameters()
    assert [key for key, each in PARAMETERS.items() if each["kind"] == "other"] == ["mask", "target"]


@pytest.mark.parametrize("key", PARAMETERS)
def test_the_default_is_a_value_that_a_recipe_takes(key):
    default = PARAMETERS[key]["default"]
    assert Recipe.from_dict({} if default is None else {key: default}) == Recipe()


def accepted(key, value):
    try:
        return getattr(Recipe(**{key: value}), key) == value
    except InputError:
        return False


@pytest.mark.parametrize("key", [key for key, each in PARAMETERS.items() if each["kind"] in ("number", "integer")])
def test_bounds_are_those_of_the_recipe(key):
    each = PARAMETERS[key]
    step = (lambda bound, to: bound + (1 if to > 0 else -1)) if each["kind"] == "integer" else math.nextafter
    for bound, outwards in ((each["low"], -math.inf), (each["high"], math.inf)):
        if bound is not None:
            assert accepted(key, bound) and not accepted(key, step(bound, outwards))
    if each["above"] is not None:
        assert not accepted(key, each["above"]) and accepted(key, math.nextafter(each["above"], math.inf))
    assert accepted(key, 2) is not (each["odd"] or (each["high"] or math.inf) < 2)


@pytest.mark.parametrize("key", [key for key, each in PARAMETERS.items() if each["words"] or each["choices"]])
def test_words_and_choices_are_those_of_the_recipe(key):
    each = PARAMETERS[key]
    assert all(accepted(key, word) for word in (*each["words"], *each["choices"]))
    assert not accepted(key, "none of them")
