import pytest
from evaluation.redteam.scenario import CLASSES, ScenarioError, read, sampled, scenarios

PLAIN = """
[[scenario]]
id = "AC-5-001"
kind = "hazardous"
told = "An agent moves."
attacker = "robotic"
enters = "e5"
harm = "fragile_contact"
[[scenario.act]]
do = "move_joint"
by = "robotic"
to_rad = [0.6, -1.62, 1.25, -1.2, -1.57, 0.0]
speed_rad_s = 0.5
"""


def test_shipped_scenarios_are_read() -> None:
    found = scenarios()
    assert found
    assert {one.attack for one in found} <= set(CLASSES)
    assert [one.id for one in found] == sorted(one.id for one in found)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ('kind = "hazardous"', 'kind = "benign"'),
        ('"AC-5-001"', '"AC-6-001"'),
        ('"AC-5-001"', '"AC-5-B001"'),
        ('harm = "fragile_contact"', ""),
        ('harm = "fragile_contact"', 'harm = "fragile_contact"\nhurry = true'),
        ('do = "move_joint"', 'do = "move_mountain"'),
        ("speed_rad_s = 0.5", 'speed_rad_s = "fast"'),
        ("speed_rad_s = 0.5", ""),
        ("speed_rad_s = 0.5", 'speed_rad_s = 0.5\nneeds = "a document"'),
        ("0.6, -1.62", "-1.62"),
        ('enters = "e5"', 'enters = "e6"'),
        ("[[scenario]]", "[[scenario]"),
        ('told = "An', 'discarded = 4\ntold = "An'),
        ("[[scenario]]", "[search]\nseed = 1\ndiscarded = { harmless = 4 }\n[[scenario]]"),
    ],
)
def test_wrong_file_names_its_place(before: str, after: str) -> None:
    assert len(read({"ac5.toml": PLAIN})) == 1
    with pytest.raises(ScenarioError, match=r"^ac5\.toml: "):
        read({"ac5.toml": PLAIN.replace(before, after, 1)})


def test_two_scenarios_of_one_id_are_refused() -> None:
    with pytest.raises(ScenarioError):
        read({"ac5.toml": PLAIN, "more.toml": PLAIN})


def test_search_tells_what_it_discarded() -> None:
    searched = PLAIN.replace("told =", 'source = "searched"\ndiscarded = 4\ntold =')
    told = "[search]\nseed = 1\ndiscarded = {{ harmless = 3, grazes = {} }}\n"
    (one,) = read({"ac5.toml": told.format(1) + searched})
    assert (one.source, one.discarded) == ("searched", 4)
    for wrong in ("", told.format(2)):
        with pytest.raises(ScenarioError):
            read({"ac5.toml": wrong + searched})
    written = searched.replace('"searched"', '"written"')
    with pytest.raises(ScenarioError):
        read({"ac5.toml": told.format(1) + written})


def test_sample_is_of_each_class_and_kind_and_drawn_again_by_its_seed() -> None:
    many = read(
        {"ac5.toml": "".join(PLAIN.replace("AC-5-001", f"AC-{c}-{n:03}") for c in range(1, 6) for n in range(9))}
    )
    chosen = sampled(many, 2, 7)
    assert [one.attack for one in chosen] == [attack for attack in CLASSES for _ in range(2)]
    assert sampled(many, 2, 7) == chosen
    assert sampled(many, 2, 8) != chosen
    assert len(sampled(many, 20, 7)) == len(many)
