"""Reader of a client's bytes on port 30004, with the parts that the gateway reads them with."""

from dataclasses import dataclass, field

from pep.rtde.command.image_changes import Change, changes
from pep.rtde.command.io_commands import IoCommand, decode_io
from pep.rtde.command.register_image import RegisterImage
from pep.rtde.wire.codec import Framer, decode_request
from pep.rtde.wire.messages import SetupInputs, Values
from pep.rtde.wire.recipes import Ignored, InputRecipes, WritableVariables
from pep.rtde.wire.refusal import InputRefusal


@dataclass
class Heard:
    """Content of one connection."""

    recipes: list[tuple[str, ...]] = field(default_factory=list)
    changes: list[Change | InputRefusal | Ignored] = field(default_factory=list)
    outputs: list[IoCommand] = field(default_factory=list)
    image: RegisterImage | None = None


def hear(said: bytes, profile: WritableVariables) -> Heard:
    """Content of `said`; a refusal of the reader itself fails."""
    heard, image, recipes = Heard(), RegisterImage.blank(profile), InputRecipes(profile)
    for frame in Framer().feed(said):
        match decode_request(frame, 2):
            case SetupInputs(names):
                assert not isinstance(recipes.set_up(names), InputRefusal)
                heard.recipes.append(names)
            case Values() as values:
                package = recipes.read(values)
                if isinstance(package, Ignored):
                    heard.changes.append(package)
                    continue
                assert not isinstance(package, InputRefusal)
                after = image.merge(package)
                assert not isinstance(after, InputRefusal)
                heard.changes.append(changes(image, after))
                outputs = decode_io(after, package)
                assert not isinstance(outputs, InputRefusal)
                heard.outputs += outputs
                image = after
    heard.image = image
    return heard
