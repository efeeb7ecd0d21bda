"""Floating car data: against the run of SUMO that wrote it, by hand, and with all its faults."""

from __future__ import annotations

import gzip
import shutil
from collections.abc import Sequence
from pathlib import Path

import libsumo
import numpy as np
import pytest

from hatn_sim.config import RecordedSource, Scenario, load_scenario
from hatn_sim.datatypes import Frame, Kind
from hatn_sim.errors import InputError
from hatn_sim.recordings.fcd.recording import FcdRecording
from hatn_sim.recordings.fcd.vehicle_types import guessed, of_class, read_colour, read_types
from hatn_sim.recordings.maps import read_lanes
from hatn_sim.simulators.sumo import SumoSimulator

NETS = Path(__file__).parent / "nets"
STREET_NET = NETS / "street.net.xml"


def recording(tracks: Path, net: Path = STREET_NET) -> FcdRecording:
    return FcdRecording("made_up", RecordedSource((tracks,), net))


def recorded(scenario: Scenario, tracks: Path, steps: int, *options: str) -> list[Frame]:
    """SUMO's own frames of the run that writes the file: it writes each step's state."""
    with SumoSimulator(scenario, ("--fcd-output", str(tracks), *options)) as simulator:
        simulator.reset(1)
        return [simulator.step() for _ in range(steps)]


def assert_same_traffic(
    frames: Sequence[Frame], expected: Sequence[Frame], digits_off: float, angle_off_rad: float
) -> None:
    assert len(frames) == len(expected)
    for frame, other in zip(frames, expected, strict=True):
        here, there = frame.scene, other.scene
        assert here.ids == there.ids
        # SUMO writes the state at the end of a step under the time of its beginning.
        assert here.time_s == pytest.approx(there.time_s - 0.1)
        np.testing.assert_allclose(here.xy_m, there.xy_m, rtol=0, atol=digits_off)
        np.testing.assert_allclose(here.speed_mps, there.speed_mps, rtol=0, atol=digits_off)
        turned = np.angle(np.exp(1j * (here.yaw_rad - there.yaw_rad)))
        np.testing.assert_allclose(turned, 0, atol=angle_off_rad)
        assert (np.abs(here.yaw_rad) <= np.pi).all()
        for name in ("size_m", "kind", "colour", "blinker"):
            np.testing.assert_array_equal(getattr(here, name), getattr(there, name))


# ---------------------------------------------------------------------------------------------
# Against SUMO


@pytest.mark.parametrize(
    ("name", "options", "digits_off", "angle_off_rad"),
    [
        # Two decimals: half of a hundredth, and of a hundredth of a degree at half of 12 m.
        ("tracks.xml", (), 0.0062, 1e-4),
        ("tracks.xml.gz", ("--precision", "12"), 1e-10, 1e-12),
        # Angles and speeds are float32 there.
        ("tracks.parquet", (), 5e-6, 5e-7),
    ],
)
def test_frames_are_those_of_the_run(
    tmp_path: Path, name: str, options: tuple[str, ...], digits_off: float, angle_off_rad: float
) -> None:
    scenario = load_scenario("intersection5")
    assert scenario.driver_path is not None
    shutil.copy(scenario.driver_path, tmp_path)  # where the sizes are looked for
    expected = recorded(scenario, tmp_path / name, 450, "--fcd-output.signals", *options)
    net = scenario.config_path.parent / "intersection5.net.xml"
    played = recording(tmp_path / name, net)
    frames = list(played.frames())
    assert_same_traffic(frames, expected, digits_off, angle_off_rad)
    assert [frame.done for frame in frames] == [False] * 449 + [True]
    assert {place for frame in frames for place in frame.scene.blinker} == {-1, 0, 1}
    appeared = [name for frame in frames for name in frame.truth.departed]
    assert appeared == [name for frame in expected for name in frame.truth.departed]
    assert all("blinkers" not in notice for notice in played.notices)
    assert any("vehicle types are SUMO's own and" in notice for notice in played.notices)


PEOPLE = """
<routes>
<vType id="car" length="4.5" width="1.9" color="red"/><vType id="city" vClass="bus"/>
<person id="van" depart="0"><walk edges="stop_to_east"/></person>
<vehicle id="van" type="car" depart="0">
<route edges="west_to_priority priority_to_signal"/></vehicle>
<vehicle id="b" type="city" depart="0" departSpeed="5">
<route edges="west_to_priority priority_to_signal"/></vehicle>
<person id="r" depart="triggered"><ride lines="b" to="priority_to_signal"/></person>
</routes>"""


@pytest.mark.parametrize("name", ["tracks.xml", "tracks.parquet"])
def test_who_walks_is_there_and_who_rides_is_not(tmp_path: Path, name: str) -> None:
    (tmp_path / "own.rou.xml").write_text(PEOPLE)
    config = tmp_path / "own.sumocfg"
    config.write_text(
        f'<configuration><net-file value="{STREET_NET}"/><route-files value="own.rou.xml"/>'
        "</configuration>"
    )
    scenario = load_scenario(str(config))
    expected = recorded(scenario, tmp_path / name, 30, "--precision", "12", "--fcd-output.signals")
    frames = list(recording(tmp_path / name).frames())
    assert expected[-1].scene.ids == ("b", "van", "person:van")
    assert_same_traffic(frames, expected, 1e-6, 1e-6)
    assert frames[-1].scene.kind.tolist() == [Kind.BUS, Kind.CAR, Kind.PEDESTRIAN]


def test_sizes_by_class_are_those_of_sumo(tmp_path: Path) -> None:
    classes = [
        "passenger", "taxi", "emergency", "delivery", "truck", "trailer", "bus", "coach",
        "motorcycle", "moped", "bicycle", "scooter", "tram", "rail_urban", "rail", "rail_electric",
        "rail_fast", "subway", "cable_car", "pedestrian", "wheelchair", "ship", "drone",
        "container", "aircraft", "army", "custom1",
    ]  # fmt: skip
    types = "".join(f'<vType id="my_{name}" vClass="{name}"/>' for name in classes)
    coloured = {"a": "255,128,7", "b": "0.5,0,1.0", "c": "orange", "d": "#0a0B0c"}
    types += "".join(f'<vType id="{name}" color="{text}"/>' for name, text in coloured.items())
    (tmp_path / "types.add.xml").write_text(f"<additional>{types}</additional>")
    libsumo.start(
        ["sumo", "-n", str(STREET_NET), "-a", str(tmp_path / "types.add.xml"), "--no-step-log"]
    )
    try:
        domain = libsumo.vehicletype
        for name in classes:
            mine = of_class(name)
            assert mine.length_m == domain.getLength(f"my_{name}"), name
            assert mine.width_m == domain.getWidth(f"my_{name}"), name
        for name, text in coloured.items():
            assert read_colour(text) == domain.getColor(name)[:3]
        brought = {name for name in domain.getIDList() if name.startswith("DEFAULT_")}
        known = read_types([])
        assert known.keys() == brought
        for name, mine in known.items():
            assert (mine.length_m, mine.width_m) == (domain.getLength(name), domain.getWidth(name))
    finally:
        libsumo.close()


def test_types_without_a_definition_are_guessed_by_their_names() -> None:
    words = {
        "car_12": Kind.CAR, "": Kind.CAR, "CityBus": Kind.BUS, "motorbike": Kind.MOTORCYCLE,
        "bike_fast": Kind.BICYCLE, "lorry_steady": Kind.LORRY, "tram_5": Kind.TRAM,
        "delivery van": Kind.VAN,
    }  # fmt: skip
    assert {name: guessed(name).kind for name in words} == words


# ---------------------------------------------------------------------------------------------
# Maps


def test_a_net_has_the_lanes_of_its_simulation(tmp_path: Path) -> None:
    with SumoSimulator(load_scenario(str(NETS / "street.sumocfg"))) as simulator:
        expected = simulator.lanes
    zipped = tmp_path / "street.net.xml.gz"
    zipped.write_bytes(gzip.compress(STREET_NET.read_bytes()))
    for path in (STREET_NET, zipped):
        lanes = read_lanes(path)
        assert [(lane.id, lane.successors, lane.gate, lane.signals) for lane in lanes] == [
            (lane.id, lane.successors, lane.gate, lane.signals) for lane in expected
        ]
        assert all(
            (lane.xy_m == other.xy_m).all() for lane, other in zip(lanes, expected, strict=True)
        )


def test_what_is_no_map_is_told(tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.net.xml"
    for content, words in {
        "<net><edge></net>": r"wrong\.net\.xml:1: not well-formed XML: mismatched tag",
        "<routes/>": "expected XML of <net>, found <routes>",
        '<net version="1.16"/>': "expected lanes for vehicles, found none",
    }.items():
        wrong.write_text(content)
        with pytest.raises(InputError, match=words):
            read_lanes(wrong)
    with pytest.raises(InputError, match="cannot be read: No such file"):
        read_lanes(tmp_path / "none.net.xml.gz")
    with pytest.raises(InputError, match=r"expected a map named \*\.osm"):
        read_lanes(tmp_path / "map.png")
    bomb = tmp_path / "road.json.gz"
    bomb.write_bytes(gzip.compress(b" " * (20 << 20)))
    with pytest.raises(InputError, match="expands more than 100 times"):
        read_lanes(bomb)


# ---------------------------------------------------------------------------------------------
# By hand: the street runs to the east along y = -4.8 from x = -160


def car(time_s: float, name: str = "a", **changes: object) -> str:
    """A car of 5 m at 10 m/s whose front is at -100 m at time 0."""
    values = {"id": name, "x": -100 + 10 * time_s, "y": -4.8, "angle": 90, "speed": 10} | changes
    written = " ".join(f'{key}="{value}"' for key, value in values.items() if value is not None)
    return f"<vehicle {written}/>"


def steps(times_s: Sequence[float], names: Sequence[str] = ("a",), **changes: object) -> str:
    return "".join(
        f'<timestep time="{time_s:.2f}">'
        + "".join(car(time_s, name, **changes) for name in names)
        + "</timestep>"
        for time_s in times_s
    )


def write(path: Path, content: str) -> Path:
    path.write_text(f"<fcd-export>{content}</fcd-export>", encoding="utf-8")
    return path


def tenths(first: int, last: int, unit_s: float = 0.1) -> list[float]:
    return [unit_s * number for number in range(first, last)]


def test_centres_by_hand(tmp_path: Path) -> None:
    content = (
        '<timestep time="0.0">'
        '<vehicle id="to &lt;north&gt;" x="1" y="2" angle="0" speed="3" type="bus" signals="1"/>'
        '<vehicle id="to west" x="1" y="2" angle="270" speed="0" length="6" width="2" kind="van"'
        ' color="1,2,3" signals="10"/><container id="c"/></timestep>'
    )
    (frame,) = recording(write(tmp_path / "f.xml", content)).frames()
    scene = frame.scene
    assert scene.ids == ("to <north>", "to west")
    np.testing.assert_allclose(scene.xy_m, [(1, 2 - 6), (1 + 3, 2)], atol=1e-12)
    np.testing.assert_allclose(scene.yaw_rad, [np.pi / 2, np.pi], atol=1e-12)
    np.testing.assert_array_equal(scene.size_m, [(12, 2.5), (6, 2)])
    assert scene.kind.tolist() == [Kind.BUS, Kind.VAN]
    assert scene.colour.tolist() == [[255, 255, 0], [1, 2, 3]]
    assert scene.blinker.tolist() == [-1, 1]
    assert frame.truth.routes == (None, None)
    assert frame.truth.departed == scene.ids
    assert frame.done


def test_a_finer_step_is_thinned_out(tmp_path: Path) -> None:
    for unit_s in (0.05, 0.02, 0.01):
        path = write(tmp_path / "f.xml", steps(tenths(3, 103, unit_s)))
        frames = list(recording(path).frames())
        times_s = [frame.scene.time_s for frame in frames]
        count = 1 + int(99 * unit_s / 0.1 + 1e-9)
        np.testing.assert_allclose(times_s, 3 * unit_s + 0.1 * np.arange(count), atol=1e-9)
        moved_m = np.diff([frame.scene.xy_m[0, 0] for frame in frames])
        np.testing.assert_allclose(moved_m, 1.0, atol=1e-9)


def test_moments_without_vehicles_may_be_left_out(tmp_path: Path) -> None:
    content = steps(tenths(0, 3)) + steps(tenths(7, 9), ("b",)) + '<timestep time="1.20"/>'
    frames = list(recording(write(tmp_path / "f.xml", content)).frames())
    assert [frame.scene.ids for frame in frames] == (
        [("a",)] * 3 + [()] * 4 + [("b",)] * 2 + [()] * 4
    )
    times_s = [frame.scene.time_s for frame in frames]
    np.testing.assert_allclose(times_s, 0.1 * np.arange(13), atol=1e-9)
    assert frames[3].truth.arrived == ("a",)
    assert frames[7].truth.departed == ("b",)


def test_times_may_be_written_for_people(tmp_path: Path) -> None:
    content = steps(tenths(0, 2)).replace('"0.', '"1:01:00:02.')
    times_s = [
        frame.scene.time_s for frame in recording(write(tmp_path / "f.xml", content)).frames()
    ]
    np.testing.assert_allclose(times_s, [90002.0, 90002.1])


def test_the_file_is_streamed_and_read_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from hatn_sim.recordings.fcd import recording as module

    content = steps(tenths(0, 6000), ("a", "b"), x=-100, speed=0)
    played = recording(write(tmp_path / "f.xml", content))
    assert played.notices
    read = 0
    really_read = module.read_timesteps

    def counted(path: Path) -> object:
        nonlocal read
        for step in really_read(path):
            read += 1
            yield step

    monkeypatch.setattr(module, "read_timesteps", counted)
    frames = played.frames()
    assert next(frames).scene.time_s == 0.0
    assert read <= 2
    assert next(played.frames()).scene.time_s == 0.0
    assert sum(1 for _ in frames) == 5999


def test_what_the_file_lacks_is_said(tmp_path: Path) -> None:
    path = write(tmp_path / "f.xml", steps(tenths(0, 30), type="racer"))
    (sizes, blinkers, lights) = recording(path).notices
    assert "1 vehicle types are guessed (racer)" in sizes
    assert "0.5 m" in sizes
    assert "blinkers" in blinkers
    assert "traffic lights" in lights
    (tmp_path / "own.rou.xml").write_text('<routes><vType id="racer" length="3"/></routes>')
    (tmp_path / "broken.rou.xml").write_text("<routes><vType")
    played = recording(path)
    assert "sizes of 1 vehicle types are SUMO's own and" in played.notices[0]
    assert next(played.frames()).scene.size_m.tolist() == [[3.0, 1.8]]
    told = write(tmp_path / "g.xml", steps(tenths(0, 30), length=4, width=2, signals=0))
    assert list(recording(told).notices) == [lights]


def test_some_vehicles_off_the_net_are_noticed(tmp_path: Path) -> None:
    content = steps(tenths(0, 30), ("a", "b")) + steps(tenths(30, 50), ("c",), y=-204.8)
    notice = recording(write(tmp_path / "f.xml", content)).notices[-1]
    assert "25.0% of the first 80 positions are more than 10 m from every lane" in notice
    shifted = write(tmp_path / "f.xml", steps(tenths(0, 30), y=-9.8))
    played = recording(shifted)
    assert played.notices[-1].startswith("vehicles are 5.0 m from the nearest lane's centre line")
    assert list(played.doubts) == [played.notices[-1]]


GOOD = steps(tenths(0, 30))
FAULTS = {
    "no_vehicles": (steps([0.0, 0.1], ()), "expected vehicles, found none"),
    "no_timesteps": ("", "expected timesteps with vehicles, found none"),
    "seconds": (steps(tenths(0, 9, 1.0)), "a timestep every 0.1 s, found 1.00 after 0.00 .*'a'"),
    "odd_step": (steps(tenths(0, 30, 0.04)), "a timestep every 0.1 s, found 0.20 after 0.00"),
    "hole": (GOOD + steps(tenths(35, 40)), "found 3.50 after 2.90 .*'a'.* --step-length 0.1"),
    "repeated": (GOOD + steps([2.9]), "rising order, found 2.90 after 2.90"),
    "backwards": (GOOD + steps([1.0]), "rising order, found 1.00 after 2.90"),
    "no_time": ("<timestep/>", "a time in seconds, found None"),
    "nan_time": ('<timestep time="nan"/>', "a time in seconds, found 'nan'"),
    "twice": (steps([0.0], ("a", "b", "a")), "0.00: expected every vehicle once .*'a' twice"),
    "no_id": (steps([0.0], id=None), "every vehicle once and with an id, found one without"),
    "nan": (GOOD + steps([3.0], x="nan"), "3.00: expected a number as x of 'a', found 'nan'"),
    "words": (steps([0.0], speed="fast"), "expected a number as speed of 'a', found 'fast'"),
    "lacking": (steps([0.0], angle=None), "expected a number as angle of 'a', found none"),
    "size": (steps([0.0], length=-1), "expected length in metres above 0, found '-1' of 'a'"),
    "kind": (steps([0.0], kind="lory"), "did you mean 'lorry'.*, found 'lory' of 'a'"),
    "cut_off": (GOOD + "<timestep", "not well-formed XML"),
    "utm": (
        steps(tenths(0, 30), y=5_800_000),
        "does not fit .*street.net.xml: vehicles are 5799900 m .*, 5799900 m at worst; .*utm",
    ),
    "geo": (
        "".join(steps([time_s], x=13.4 + 1e-5 * time_s) for time_s in tenths(0, 30)),
        "vehicles that move 1e-06 times as far .* without --fcd-output.geo",
    ),
    "a slip in the times": (
        steps(tenths(0, 10)) + steps([4000.0], ("later",)),
        r"timestep 4000.0*: expected pauses of at most 3600 s, found nobody for 3999 s",
    ),
    "kmh": (steps(tenths(0, 30), speed=36), "move 0.28 times as far"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_told_in_one_line(tmp_path: Path, fault: str) -> None:
    content, words = FAULTS[fault]
    path = write(tmp_path / "f.xml", content)
    with pytest.raises(InputError, match=words) as raised:
        list(recording(path).frames())
    assert str(raised.value).startswith(str(path))
    assert "\n" not in str(raised.value)


def test_files_that_are_something_else_are_told(tmp_path: Path) -> None:
    path = tmp_path / "f.xml"

    def complaint(content: bytes) -> str:
        path.write_bytes(content)
        with pytest.raises(InputError) as raised:
            list(recording(path).frames())
        return str(raised.value)

    fcd = f"<fcd-export>{GOOD}</fcd-export>".encode()
    zipped = gzip.compress(fcd)
    assert "expected XML of <fcd-export>, found <routes>" in complaint(b"<routes/>")
    assert "not well-formed XML" in complaint(b"track_id,x,y\n1,2,3\n")
    assert "cut off" in complaint(zipped[: len(zipped) // 2])
    assert "document type" in complaint(b'<!DOCTYPE a [<!ENTITY b "c">]>' + fcd)
    bomb = b"<fcd-export>" + b" " * (40 << 20) + b"</fcd-export>"
    assert "decompression bomb" in complaint(gzip.compress(bomb))
    assert "in Parquet, found a file that cannot be read" in complaint(b"PAR1 and more PAR1")
    with pytest.raises(InputError, match="cannot be read: No such file"):
        list(recording(tmp_path / "none.xml").frames())


def test_parquet_without_its_columns_is_told(tmp_path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    path = tmp_path / "f.parquet"
    pq.write_table(pa.table({"timestep_time": [0.0], "x": [1.0]}), path)
    with pytest.raises(InputError, match=r"expected a column 'id' .*, found timestep_time, x"):
        list(recording(path).frames())
    columns = {"time": [0.0, 0.1], "id": ["a", "a"], "x": [-100.0, None], "y": [-4.8, -4.8]}
    pq.write_table(pa.table(columns | {"angle": [90.0, 90.0], "speed": [0.0, 0.0]}), path)
    with pytest.raises(InputError, match=r"timestep 0\.1: expected a number as x of 'a'"):
        list(recording(path).frames())


def test_one_file_with_its_net_is_asked_for(tmp_path: Path) -> None:
    path = write(tmp_path / "f.xml", GOOD)
    cases = {
        "one file .* at a time": RecordedSource((path, path), STREET_NET),
        "leave --recordings 000 out": RecordedSource((path,), STREET_NET, ("000",)),
        "add --map FILE": RecordedSource((path,), None),
    }
    for words, source in cases.items():
        with pytest.raises(InputError, match=words):
            FcdRecording("x", source)
