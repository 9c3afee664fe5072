"""Programs that are kept on disk: read in place of tracing again, and never where something else would be traced."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

# Traced functions say so; a process that reads their programs does not.
_MODULE = """
import equinox as eqx
import jax.numpy as jnp
from jaxscan.kept_programs import compiled


class Pair(eqx.Module):
    a: object
    name: str = eqx.field(static=True)


@compiled(static_argnames="power")
def raised(pair, by=None, power=2):
    print("traced")
    found = pair.a ** power if by is None else pair.a ** power + by
    return Pair(found, pair.name), {"sum": found.sum()}


@compiled(filtered=True)
def scaled(pair, factor):
    print("traced")
    return Pair(pair.a * (factor if isinstance(factor, float) else factor(pair.a)), "scaled")


@compiled(filtered=True)
def with_words(pair):
    print("traced")
    return pair.a, "words"
"""


def said(folder: Path, body: str, *, keep: bool = True) -> list[str]:
    """What a process prints that keeps its programs in `folder`."""
    (folder / "functions.py").write_text(_MODULE)
    lines = ["from pathlib import Path", "import jax, numpy as np", "from jaxscan import kept_programs"]
    lines += [f"kept_programs.keep(Path({str(folder / 'kept')!r}))"] if keep else []
    lines += ["from functions import *", "x = np.arange(3.0, dtype=np.float32)", body]
    env = os.environ | {"PYTHONPATH": os.pathsep.join([str(folder), str(Path(__file__).parents[1])])}
    run = subprocess.run([sys.executable, "-c", "\n".join(lines)], env=env, capture_output=True, text=True, timeout=120)
    assert run.returncode == 0, run.stderr
    return run.stdout.splitlines()


RAISED = 'out, more = raised(Pair(x, "of x"), power=3); print(out.name, np.asarray(out.a).tolist(), float(more["sum"]))'
AS_RAISED = "of x [0.0, 1.0, 8.0] 9.0"


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which the program of `RAISED` is."""
    folder = tmp_path_factory.mktemp("kept")
    said(folder, RAISED)
    return folder


def test_a_second_process_reads_what_the_first_has_traced(tmp_path: Path) -> None:
    assert said(tmp_path, RAISED) == ["traced", AS_RAISED]
    assert said(tmp_path, f"{RAISED}\n{RAISED}") == [AS_RAISED, AS_RAISED]
    assert len(list((tmp_path / "kept").glob("raised-*.program"))) == 1


def test_it_is_off_by_itself(tmp_path: Path) -> None:
    for _ in range(2):
        assert said(tmp_path, RAISED, keep=False) == ["traced", AS_RAISED]
    assert not (tmp_path / "kept").exists()


@pytest.mark.parametrize(
    "other",
    [
        RAISED.replace("power=3", "power=4"),
        RAISED.replace("power=3", "by=x, power=3"),
        RAISED.replace('"of x"', '"of y"'),
        RAISED.replace("Pair(x", "Pair(x[:2]"),
        RAISED.replace("Pair(x", "Pair(x.astype(int)"),
        f"with jax.enable_x64(True): {RAISED}",
        f"jax.config.update('jax_numpy_rank_promotion', 'raise'); {RAISED}",
        f"kept_programs.version = lambda name: 'another'; {RAISED}",
    ],
)
def test_what_differs_is_traced(kept: Path, other: str) -> None:
    assert said(kept, other)[0] == "traced"


def test_the_source_of_jaxscan_belongs_to_it(tmp_path: Path) -> None:
    said(tmp_path, RAISED)
    (tmp_path / "package").mkdir()
    (tmp_path / "package" / "one.py").write_text("a = 1")
    elsewhere = f"kept_programs.__file__ = {str(tmp_path / 'package' / 'kept_programs.py')!r}\n"
    assert said(tmp_path, elsewhere + RAISED)[0] == "traced"
    assert said(tmp_path, elsewhere + RAISED)[0] != "traced"
    (tmp_path / "package" / "one.py").write_text("a = 2")
    assert said(tmp_path, elsewhere + RAISED)[0] == "traced"


def test_what_another_program_gave_compiles_nothing_more(tmp_path: Path) -> None:
    """Its arrays are committed to a device, those of NumPy are not: JAX takes these for two kinds of arguments."""
    body = "compiled_for = []\n"
    body += "say = lambda event, _, **more: 'backend_compile' in event and compiled_for.append(more.get('fun_name'))\n"
    body += "jax.monitoring.register_event_duration_secs_listener(say)\n"
    body += "first = raised(Pair(x, 'p'), by=x)[0].a\n"
    body += "for a, by in ((first, x), (x, first), (first, first)): raised(Pair(a, 'p'), by=by)\n"
    body += "print(sum('raised' in str(name) for name in compiled_for))"
    for _ in range(2):
        assert said(tmp_path, body)[-1] == "1"


def test_a_damaged_file_is_made_again(tmp_path: Path) -> None:
    said(tmp_path, RAISED)
    (path,) = (tmp_path / "kept").glob("*.program")
    whole = path.read_bytes()
    for broken in (whole[:100], b"", whole[:-1] + bytes([whole[-1] ^ 1])):
        path.write_bytes(broken)
        assert said(tmp_path, RAISED) == ["traced", AS_RAISED]
        assert said(tmp_path, RAISED) == [AS_RAISED]


def test_numbers_that_are_static_are_told_apart(tmp_path: Path) -> None:
    words = 'print(np.asarray(scaled(Pair(x, ""), {}).a).tolist())'
    assert said(tmp_path, words.format(2.0)) == ["traced", "[0.0, 2.0, 4.0]"]
    assert said(tmp_path, words.format(3.0)) == ["traced", "[0.0, 3.0, 6.0]"]
    assert said(tmp_path, words.format(2.0)) == ["[0.0, 2.0, 4.0]"]


def test_plain_numbers_are_free(tmp_path: Path) -> None:
    """As they are for `jax.jit`: another one needs no other program."""
    by = 'print(np.asarray(raised(Pair(x, ""), by={})[0].a).tolist())'
    assert said(tmp_path, by.format(1)) == ["traced", "[1.0, 2.0, 5.0]"]
    assert said(tmp_path, by.format(2) + "; " + by.format(3)) == ["[2.0, 3.0, 6.0]", "[3.0, 4.0, 7.0]"]
    assert said(tmp_path, by.format(2.5)) == ["traced", "[2.5, 3.5, 6.5]"]


def test_what_cannot_be_told_by_its_words_is_not_kept(tmp_path: Path) -> None:
    """Two functions may have one name; and words that come back are in no program."""
    words = 'print(np.asarray(scaled(Pair(x, ""), lambda a: {}).a).tolist())'
    assert said(tmp_path, words.format("2.0")) == ["traced", "[0.0, 2.0, 4.0]"]
    assert said(tmp_path, words.format("3.0")) == ["traced", "[0.0, 3.0, 6.0]"]
    for _ in range(2):
        *_, last = said(tmp_path, 'a, b = with_words(Pair(x, "")); print(b)')
        assert last == "words"
    assert not list((tmp_path / "kept").glob("*.program"))


def test_several_devices_share_work_as_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XLA_FLAGS", "--xla_force_host_platform_device_count=2")
    body = "from jax.sharding import PartitionSpec as P\n"
    body += "x = jax.device_put(np.arange(4.0), jax.NamedSharding(jax.make_mesh((2,), ('a',)), P('a')))\n"
    body += 'out, _ = raised(Pair(x, "of x")); print(np.asarray(out.a).tolist(), len(out.a.devices()))'
    for _ in range(2):
        assert said(tmp_path, body) == ["traced", "[0.0, 1.0, 4.0, 9.0] 2"]


def test_within_another_function_it_is_a_part_of_that(tmp_path: Path) -> None:
    inside = 'print(jax.jit(lambda x: raised(Pair(x, ""), power=3)[1]["sum"])(x))'
    assert said(tmp_path, inside) == ["traced", "9.0"]
    derivative = 'print(jax.grad(lambda x: raised(Pair(x, ""), power=3)[1]["sum"])(x))'
    assert said(tmp_path, derivative)[-1] == "[ 0.  3. 12.]"


@pytest.mark.parametrize("keep", [True, False])
def test_what_is_known_where_another_function_is_traced_is_computed(tmp_path: Path, keep: bool) -> None:
    """Options of the compiler are for programs that are nobody's part."""
    body = 'other = jax.jit(lambda y: raised(Pair(x, ""), power=3)[0].a + y); print(np.asarray(other(1.0)).tolist())'
    assert said(tmp_path, body, keep=keep) == ["traced", "[1.0, 2.0, 9.0]"]


def test_a_compiler_that_does_not_know_our_options_does_without(tmp_path: Path) -> None:
    unknown = 'kept_programs._FAST_TO_COMPILE["xla_cpu_no_such_option"] = True; '
    assert said(tmp_path, f"{unknown}print(kept_programs._options()); {RAISED}") == ["None", "traced", AS_RAISED]
    (known,) = said(tmp_path, "print(kept_programs._options())")
    assert known == "{'xla_cpu_use_fusion_emitters': False}"


def test_commands_keep_theirs(tmp_path: Path) -> None:
    """A process of our own keeps programs where JAX keeps what it has compiled; one that only calls us does not."""
    body = """
from jaxscan.cli.compiled import keep_compiled
from jaxscan.cli.process import run_as_process
def program():
    import numpy as np
    keep_compiled()
    from jaxscan.images.stripes.coarse import choose_peaks, coarse_peaks
    image = np.random.default_rng(0).integers(0, 255, (1, 64, 48), np.uint8)
    print(np.asarray(choose_peaks(coarse_peaks(image, None, np.zeros(1, np.int32), "grey", True), 64, True)[0]).sum())
    return 0
"""
    env = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    env |= {"XDG_CACHE_HOME": str(tmp_path), "JAX_PLATFORMS": "cpu"}
    answers = []
    for end in ("program()", "run_as_process(program)", "run_as_process(program)"):
        run = subprocess.run([sys.executable, "-c", body + end], env=env, capture_output=True, text=True, timeout=120)
        assert run.returncode == 0, run.stderr
        kept = sorted(path.name.split("-")[0] for path in (tmp_path / "jaxscan" / "compiled").glob("*.program"))
        answers.append((run.stdout, kept))
    assert answers[0][1] == []
    assert answers[1][1] == answers[2][1] == ["choose_peaks", "coarse_peaks"]
    assert len({printed for printed, _ in answers}) == 1
