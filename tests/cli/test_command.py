"""A command is a model: its fields are options, with their types in the help."""

import json
from typing import Annotated, Any, Literal

import pytest
from click.testing import CliRunner
from pydantic import BaseModel, Field

from deepfsi.base.errors import InputError
from deepfsi.base.models import Seconds, Share, WholeNumber
from deepfsi.base.quantities import Table
from deepfsi.cli import command
from deepfsi.cli import fields as fields_module
from deepfsi.cli import terminal as terminal_module


class Thing(BaseModel):
    width: int = Field(3, ge=1, le=9, description="how wide it is")
    folded: bool = Field(False, description="fold it")
    kind: Literal["oak", "ash"] = Field("oak", description="its wood")
    weight: float = Field(description="its weight", gt=0)


class Show(command.Command):
    """What it shows."""

    name: Annotated[str, fields_module.argument("of the thing", "THING")]
    settings: Annotated[
        dict[str, Any],
        fields_module.OptionsOf({n: ("Things", n, f) for n, f in Thing.model_fields.items()}),
    ]
    times: Annotated[Seconds | None, Field(gt=0, description="how long")] = None
    part: Annotated[Share, Field(description="share of it")] = 0.5
    places: Annotated[tuple[WholeNumber, ...], Field(alias="place", description="where")] = ()
    budgets: Annotated[fields_module.NumberList, Field(description="light")] = (1.0,)
    size: fields_module.Size = None
    deep: Annotated[bool, Field(description="all of it")] = False

    def run(self, terminal: terminal_module.Terminal) -> terminal_module.Outcome:
        """What was read."""
        terminal.say("at once")
        return terminal_module.Outcome(
            self.model_dump(mode="json"),
            [f"shown: {self.name}", Table("things", ("name",), [(self.name,)])],
            failed=self.name == "bad",
            refusal='it is torn: leave `loss` out, or give `light="dose"`'
            if self.name == "torn"
            else "",
        )


def run(*words: str) -> tuple[int, str]:
    result = CliRunner().invoke(command.ClickCommand(Show, "show", "Show a thing."), words)
    if isinstance(result.exception, InputError):
        raise result.exception
    return result.exit_code, result.output


def test_texts_are_read_as_the_types_say():
    words = "--json it --times 10ms --part 1 --place 3 --place 0 --budgets 1,2e3 --size 4x5"
    code, out = run(*words.split(), "--width", "5", "--folded")
    assert code == 0
    assert json.loads(out) == {
        "schema": "deepfsi./1", "name": "it", "settings": {"width": "5", "folded": True},
        "times": 0.01, "part": 1.0, "places": [3, 0], "budgets": [1.0, 2e3], "size": [4, 5],
        "deep": False,
    }  # fmt: skip


def test_a_result_says_itself_and_its_exit_code():
    code, out = run("it")
    assert code == 0
    assert [line for line in out.split("\n") if line.strip()][:3] == [
        "at once", "shown: it", "things",
    ]  # fmt: skip
    assert run("bad")[0] == 1
    assert "at once" not in run("bad", "--json")[1]
    with pytest.raises(InputError, match="it is torn: leave `loss` out, or give --light dose"):
        run("torn")


HELP = (
    "Show a thing. What it shows.",
    "Arguments: THING of the thing",
    "Options: --times <time> how long",
    "--part <number> share of it [default: 0.5]",
    "--place <int …> where",
    "--budgets <number,…> light",
    "--size <HEIGHTxWIDTH> resize",
    "--deep all of it",
    "--json print JSON",
    "Things: --width <int> how wide it is [default: 3]",
    "--folded fold it",
    "--kind <oak|ash> its wood [default: oak]",
)


def test_help_shows_types_and_defaults_under_headings():
    told = " ".join(run("--help")[1].split())
    assert [words for words in HELP if words not in told] == []


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("it --part 2", "--part 2: give 1 or less"),
        ("it --place 1.5", "--place 1.5: give a whole number"),
        ("it --budgets 1,,2", "--budgets: '1,,2' has an empty place: give one value or more"),
        ("it --budgets 1,many", "--budgets many: give a number"),
        ("it --times soon", "--times: 'soon' is not a time"),
        ("it --size 4x --part -1", "--part -1: give 0 or more; --size: '4x' is not allowed"),
    ],
)
def test_what_cannot_be_read_is_named_by_its_option(words, message):
    with pytest.raises(InputError) as error:
        run(*words.split())
    assert message in str(error.value)


def test_an_axis_takes_several_values():
    fields = {"width": ("Things", "width", Thing.model_fields["width"])}

    class Compare(command.Command):
        """Of several."""

        settings: Annotated[dict[str, Any], fields_module.OptionsOf(fields, axes=True)]

    [width] = command.ClickCommand(Compare, "compare", "").headings["Things"]
    assert (width.metavar, width.help) == ("<int,…>", "how wide it is")
