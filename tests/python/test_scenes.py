"""Hold the scenes of the four locomotion tasks equal to Gymnasium's `-v4` and `-v5` models.

The scenes are written by our own hand; only the numbers and orders are the field's. So equality is
asked where it matters, in the compiled model and in the trajectories it gives, and to the last bit:
a difference of one rounding soon grows into another trajectory.
"""

import importlib
import re
import sys
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from types import ModuleType
from typing import Any, TypeAlias, cast

import gymnasium
import numpy as np
import numpy.typing as npt
import pytest

# MuJoCo's wheel carries no type stubs: its objects are `Any`, said once here and not at every use.
mujoco: Any = importlib.import_module("mujoco")
mujoco_structs: Any = importlib.import_module("mujoco.introspect.structs")
MjModel: TypeAlias = Any

Array: TypeAlias = npt.NDArray[Any]

SCENES = Path(__file__).parents[2] / "scenes"

PHYSICS_TREE = ("opt", "stat")
"""Members of mjModel that are structs of numbers themselves, and are walked like mjModel."""

COSMETIC: Mapping[str, str] = {
    "vis": "how a scene is drawn: headlight, shadow map, clipping planes",
    "ncam": "cameras see and touch nothing; ours stand elsewhere",
    "cam_*": "see ncam",
    "nlight": "lights touch nothing; ours follow the torso",
    "light_*": "see nlight",
    "nmat": "materials are looks; MuJoCo takes friction and density from geoms",
    "mat_*": "see nmat",
    "geom_matid": "which look a geom has",
    "geom_rgba": "colour",
    "ntex": "textures are looks",
    "ntexdata": "see ntex",
    "tex_*": "see ntex",
    "names": "names are labels; those that have a meaning are held by a test of their own",
    "nnames": "see names",
    "names_map": "hash map from name to id",
    "nnames_map": "size of that hash map: it counts cameras, lights, materials and textures too",
    "name_*": "addresses into names",
    "nbuffer": "bytes of all arrays together, pixels and names among them",
    "signature": "hash over the model's elements, textures and materials among them",
    "nuser_geom": "Gymnasium's cheetah reserves a user number per geom that nothing sets or reads",
    "geom_user": "see nuser_geom",
    "nnumeric": "Gymnasium's ant carries an init_qpos that neither -v4 nor MuJoCo reads",
    "nnumericdata": "see nnumeric",
    "numeric_*": "see nnumeric",
}
"""Fields left out of the comparison, each with the reason. What is not named here is compared."""

KEY_FIELDS = frozenset(
    {
        "actuator_ctrlrange",
        "actuator_gear",
        "actuator_trnid",
        "body_inertia",
        "body_ipos",
        "body_iquat",
        "body_mass",
        "body_parentid",
        "body_pos",
        "dof_armature",
        "dof_damping",
        "geom_bodyid",
        "geom_conaffinity",
        "geom_condim",
        "geom_contype",
        "geom_friction",
        "geom_margin",
        "geom_pos",
        "geom_quat",
        "geom_size",
        "geom_solimp",
        "geom_solref",
        "jnt_axis",
        "jnt_limited",
        "jnt_margin",
        "jnt_pos",
        "jnt_range",
        "jnt_solimp",
        "jnt_stiffness",
        "jnt_type",
        "nq",
        "nu",
        "nv",
        "opt.disableflags",
        "opt.gravity",
        "opt.integrator",
        "opt.iterations",
        "opt.solver",
        "opt.timestep",
        "opt.tolerance",
        "qpos0",
        "qpos_spring",
        "stat.meaninertia",
    }
)
"""Fields that must have been compared: they name what a task's dynamics stand on."""


@dataclass(frozen=True)
class Task:
    """One scene and the environment it has to equal."""

    scene: str
    gymnasium_id: str
    joints: tuple[str, ...]
    actuators: tuple[str, ...]


TASKS = (
    Task(
        scene="hopper",
        gymnasium_id="Hopper-v4",
        joints=("rootx", "rootz", "rooty", "thigh_joint", "leg_joint", "foot_joint"),
        actuators=("thigh_joint", "leg_joint", "foot_joint"),
    ),
    Task(
        scene="walker2d",
        gymnasium_id="Walker2d-v4",
        joints=(
            *("rootx", "rootz", "rooty"),
            *("thigh_joint", "leg_joint", "foot_joint"),
            *("thigh_left_joint", "leg_left_joint", "foot_left_joint"),
        ),
        actuators=(
            *("thigh_joint", "leg_joint", "foot_joint"),
            *("thigh_left_joint", "leg_left_joint", "foot_left_joint"),
        ),
    ),
    Task(
        scene="halfcheetah",
        gymnasium_id="HalfCheetah-v4",
        joints=(
            *("rootx", "rootz", "rooty"),
            *("bthigh", "bshin", "bfoot"),
            *("fthigh", "fshin", "ffoot"),
        ),
        actuators=("bthigh", "bshin", "bfoot", "fthigh", "fshin", "ffoot"),
    ),
    Task(
        scene="ant",
        gymnasium_id="Ant-v4",
        joints=(
            "root",
            *("hip_1", "ankle_1", "hip_2", "ankle_2", "hip_3", "ankle_3", "hip_4", "ankle_4"),
        ),
        actuators=("hip_4", "ankle_4", "hip_1", "ankle_1", "hip_2", "ankle_2", "hip_3", "ankle_3"),
    ),
)

# As `-v5` defines them: walker2d has another robot, the others have the same.
TASKS_GYM5 = tuple(
    replace(
        task,
        scene="walker2d-gym5" if task.scene == "walker2d" else task.scene,
        gymnasium_id=task.gymnasium_id.replace("-v4", "-v5"),
    )
    for task in TASKS
)

each_task = pytest.mark.parametrize(
    "task", [*TASKS, *TASKS_GYM5], ids=lambda task: cast("Task", task).gymnasium_id
)


@dataclass(frozen=True)
class Reference:
    """What Gymnasium made of a task: the compiled model, and the physics steps one action lasts."""

    model: MjModel
    frame_skip: int


@dataclass(frozen=True)
class Comparison:
    """Which fields of two models were compared, and a readable line for each one that differs."""

    compared: frozenset[str]
    differences: Mapping[str, str]


def scene_xml(scene: str) -> str:
    """Read the text of one of our scenes."""
    return (SCENES / f"{scene}.xml").read_text(encoding="utf-8")


def compile_xml(xml: str) -> MjModel:
    """Compile MJCF text."""
    return mujoco.MjModel.from_xml_string(xml)


def import_gymnasium_mujoco() -> None:
    """Import Gymnasium's MuJoCo environments even where `imageio` is not installed.

    Gymnasium imports it at module level for one key of its window viewer. No window is opened here,
    so an empty module stands in for it during the import, and only then: other tests must not find
    it.
    """
    try:
        importlib.import_module("gymnasium.envs.mujoco")
    except ModuleNotFoundError as error:
        if error.name != "imageio":
            raise
        sys.modules["imageio"] = ModuleType("imageio")
        try:
            importlib.import_module("gymnasium.envs.mujoco")
        finally:
            del sys.modules["imageio"]


def load_reference(task: Task) -> Reference:
    """Make the Gymnasium environment itself: which asset it picks is part of what is tested."""
    import_gymnasium_mujoco()
    with warnings.catch_warnings():
        # "out of date, consider v5": -v4 is the one our tasks define themselves by.
        warnings.simplefilter("ignore", DeprecationWarning)
        env = cast("Any", gymnasium.make(task.gymnasium_id))
    try:
        return Reference(model=env.unwrapped.model, frame_skip=int(env.unwrapped.frame_skip))
    finally:
        env.close()


def cosmetic_pattern(field: str) -> str | None:
    """Return the exclusion a field falls under, if any."""
    return next((pattern for pattern in COSMETIC if fnmatchcase(field, pattern)), None)


def physics_fields(struct: object, prefix: str = "") -> Iterator[tuple[str, Array]]:
    """Yield every number of an mjModel that is not excluded, as an array under its field's name.

    Walks whatever attributes the binding has, so that a field added by a later MuJoCo is compared
    without anybody having to think of it; an attribute of an unknown kind is an error and not
    skipped. Names with an underscore in front are the binding's own views of the same fields.
    """
    for name in dir(struct):
        field = prefix + name
        if name.startswith("_") or cosmetic_pattern(field) is not None:
            continue
        value: object = getattr(struct, name)
        if isinstance(value, np.ndarray):
            yield field, cast("Array", value)
        elif isinstance(value, int | float):
            yield field, np.asarray(value)
        elif isinstance(value, bytes):
            yield field, np.frombuffer(value, dtype=np.uint8)
        elif field in PHYSICS_TREE:
            yield from physics_fields(value, prefix=f"{field}.")
        elif not callable(value):
            raise TypeError(f"field {field} is a {type(value).__name__}: say how to compare it")


def describe_difference(ours: Array, theirs: Array) -> str | None:
    """Give both values where they differ in shape, type or any bit; None where they do not.

    Bits and not `==`: -0.0 is another number than 0.0 here, and a NaN equals itself.
    """
    if ours.shape != theirs.shape or ours.dtype != theirs.dtype:
        return f"ours {ours.dtype}{ours.shape}, Gymnasium's {theirs.dtype}{theirs.shape}"
    if ours.tobytes() == theirs.tobytes():
        return None
    elements = zip(ours.ravel().tolist(), theirs.ravel().tolist(), strict=True)
    unequal = [
        f"[{index}] ours {our!r}, Gymnasium's {their!r}"
        for index, (our, their) in enumerate(elements)
        if np.asarray(our, ours.dtype).tobytes() != np.asarray(their, ours.dtype).tobytes()
    ]
    return "; ".join(unequal)


def compare(ours: MjModel, theirs: MjModel) -> Comparison:
    """Compare two compiled models in every field that is not cosmetic."""
    our_fields = dict(physics_fields(ours))
    their_fields = dict(physics_fields(theirs))
    assert our_fields.keys() == their_fields.keys()
    differences: dict[str, str] = {}
    for field, our_value in our_fields.items():
        difference = describe_difference(our_value, their_fields[field])
        if difference is not None:
            differences[field] = difference
    return Comparison(compared=frozenset(our_fields), differences=differences)


def element_names(model: MjModel, kind: str, count: int) -> tuple[str, ...]:
    """List the names of all elements of a kind in the model's order; "" for a nameless one."""
    accessor = getattr(model, kind)
    return tuple(str(accessor(index).name) for index in range(count))


@dataclass(frozen=True)
class Rollout:
    """State after each control step as raw bytes, and how often something touched something."""

    states: tuple[bytes, ...]
    contacts: int


def roll_out(model: MjModel, frame_skip: int, seed: int, steps: int = 200) -> Rollout:
    """Drive a model from a random state with random actions, all drawn from `seed` alone."""
    generator = np.random.default_rng(seed)
    data = mujoco.MjData(model)
    data.qpos[:] = model.qpos0 + generator.uniform(-0.1, 0.1, size=model.nq)
    data.qvel[:] = generator.standard_normal(size=model.nv)
    actions = generator.uniform(-1.0, 1.0, size=(steps, model.nu))
    states: list[bytes] = []
    contacts = 0
    for action in actions:
        data.ctrl[:] = action
        mujoco.mj_step(model, data, nstep=frame_skip)
        states.append(data.qpos.tobytes() + data.qvel.tobytes())
        contacts += int(data.ncon)
    assert np.isfinite(data.qpos).all()
    assert np.isfinite(data.qvel).all()
    assert all(int(warning.number) == 0 for warning in data.warning), "unstable rollout"
    return Rollout(states=tuple(states), contacts=contacts)


@pytest.fixture(autouse=True)
def mujoco_warns_of_nothing_but_settotalmass() -> Iterator[None]:
    """Take MuJoCo's warnings; without a taker it appends them to a file in the working directory.

    The one expected is about halfcheetah's `settotalmass`, a fact of Gymnasium's model as of ours.
    """
    messages: list[str] = []
    former: object = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(messages.append)
    yield
    mujoco.set_mju_user_warning(former)
    assert [message for message in messages if "settotalmass" not in message] == []


@each_task
def test_compiled_model_equals_gymnasium_in_every_physics_field(task: Task) -> None:
    comparison = compare(compile_xml(scene_xml(task.scene)), load_reference(task).model)

    report = "\n".join(f"{field}: {line}" for field, line in comparison.differences.items())
    assert not comparison.differences, f"{task.scene} differs from {task.gymnasium_id}:\n{report}"
    assert comparison.compared >= KEY_FIELDS


@each_task
def test_every_field_of_the_c_struct_is_compared_or_excluded_by_name(task: Task) -> None:
    """The walk goes over Python attributes; MuJoCo's description of mjModel is the yardstick."""
    compared = compare(compile_xml(scene_xml(task.scene)), load_reference(task).model).compared
    # `buffer` is the one allocation that all other arrays point into.
    declared = {str(field.name) for field in mujoco_structs.STRUCTS["mjModel"].fields} - {"buffer"}
    for member, struct in (("opt", "mjOption"), ("stat", "mjStatistic")):
        declared.remove(member)
        declared |= {f"{member}.{field.name}" for field in mujoco_structs.STRUCTS[struct].fields}

    assert {field for field in declared if cosmetic_pattern(field) is None} == compared


def test_every_exclusion_excludes_something() -> None:
    """A pattern that matches nothing is a slip of the pen, or a hole waiting for such a field."""
    declared = [str(field.name) for field in mujoco_structs.STRUCTS["mjModel"].fields]

    assert {cosmetic_pattern(field) for field in declared} - {None} == set(COSMETIC)


@pytest.mark.parametrize(
    ("scene", "ours", "mutated", "field"),
    [
        ("hopper", 'friction="2.0"', 'friction="2.1"', "geom_friction"),
        ("hopper", 'integrator="RK4"', 'integrator="Euler"', "opt.integrator"),
        ("hopper", 'armature="1"', 'armature="1.01"', "dof_armature"),
        ("hopper", 'ref="1.25"', 'ref="1.2"', "qpos0"),
        ("walker2d", "-0.22500000000000009", "-0.225", "geom_pos"),
        ("walker2d", 'friction="1.9 0.1 0.1"', 'friction="0.9 0.1 0.1"', "geom_friction"),
        ("walker2d-gym5", 'friction="1.9 0.1 0.1"', 'friction="0.9 0.1 0.1"', "geom_friction"),
        ("walker2d", 'range="-45 45"', 'range="-45 46"', "jnt_range"),
        ("walker2d", 'timestep="0.002"', 'timestep="0.0021"', "opt.timestep"),
        ("halfcheetah", 'settotalmass="14"', 'settotalmass="14.000001"', "body_mass"),
        ("halfcheetah", 'axisangle="0 1 0 -3.8"', 'axisangle="0 1 0 -3.81"', "geom_quat"),
        ("halfcheetah", 'gear="30"', 'gear="31"', "actuator_gear"),
        ("halfcheetah", 'stiffness="60"', 'stiffness="61"', "jnt_stiffness"),
        ("ant", 'density="5"', 'density="5.000001"', "body_mass"),
        ("ant", 'joint="hip_4"', 'joint="hip_1"', "actuator_trnid"),
        ("ant", 'conaffinity="0"', 'conaffinity="1"', "geom_conaffinity"),
        ("ant", 'margin="0.01" friction', 'margin="0.011" friction', "geom_margin"),
    ],
)
def test_one_changed_number_is_reported_under_its_field(
    scene: str, ours: str, mutated: str, field: str
) -> None:
    """The comparison must see what it claims to see, down to the last digit of a number."""
    xml = scene_xml(scene)
    assert ours in xml

    comparison = compare(compile_xml(xml.replace(ours, mutated, 1)), compile_xml(xml))

    assert field in comparison.differences


@each_task
def test_another_colour_is_no_difference(task: Task) -> None:
    xml = scene_xml(task.scene)
    repainted = re.sub(r'rgba="[^"]*"', 'rgba="0.5 0.5 0.5 1"', xml)
    assert repainted != xml

    assert not compare(compile_xml(repainted), compile_xml(xml)).differences


@each_task
def test_joints_and_actuators_bear_their_standard_names_in_standard_order(task: Task) -> None:
    model = compile_xml(scene_xml(task.scene))

    assert element_names(model, "joint", model.njnt) == task.joints
    assert element_names(model, "actuator", model.nu) == task.actuators
    driven = cast("list[int]", model.actuator_trnid[:, 0].tolist())
    assert task.actuators == tuple(task.joints[joint] for joint in driven)


@each_task
def test_every_name_gymnasium_gives_is_kept_and_no_element_is_nameless(task: Task) -> None:
    """Programs address elements by the field's names; where Gymnasium gives none, we give one."""
    ours = compile_xml(scene_xml(task.scene))
    theirs = load_reference(task).model
    for kind, count in (("body", ours.nbody), ("joint", ours.njnt), ("geom", ours.ngeom)):
        our_names = element_names(ours, kind, count)
        their_names = element_names(theirs, kind, count)
        assert all(our_names), f"a {kind} of {task.scene} has no name"
        assert [
            (our, their)
            for our, their in zip(our_names, their_names, strict=True)
            if their and our != their
        ] == []


@each_task
def test_a_camera_named_track_follows_the_torso(task: Task) -> None:
    model = compile_xml(scene_xml(task.scene))
    camera = model.camera("track")

    assert int(camera.bodyid[0]) == model.body("torso").id
    assert int(camera.mode[0]) == int(mujoco.mjtCamLight.mjCAMLIGHT_TRACKCOM)


@pytest.mark.parametrize("seed", [0, 1, 2])
@each_task
def test_trajectories_equal_gymnasium_byte_for_byte(task: Task, seed: int) -> None:
    reference = load_reference(task)

    ours = roll_out(compile_xml(scene_xml(task.scene)), reference.frame_skip, seed)
    theirs = roll_out(reference.model, reference.frame_skip, seed)

    assert ours.contacts > 0, "nothing ever touched the floor: contact parameters went untested"
    differing = [
        step for step, (a, b) in enumerate(zip(ours.states, theirs.states, strict=True)) if a != b
    ]
    assert not differing, f"state differs first after step {differing[0]}"


def test_trajectories_differ_when_a_friction_does() -> None:
    """The byte comparison would be empty if a rollout did not depend on the model."""
    xml = scene_xml("hopper")
    ours = roll_out(compile_xml(xml), frame_skip=4, seed=0)
    mutated = roll_out(compile_xml(xml.replace('friction="2.0"', 'friction="0.5"')), 4, seed=0)

    assert ours.states != mutated.states
