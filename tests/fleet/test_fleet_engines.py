"""Records by processes, shares and dask: the same bytes, whoever dies, whatever a file holds, wherever it is."""

from __future__ import annotations

import contextlib
import errno
import multiprocessing
import os
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from fleet.fleet_rig import FACTS, files_of, filled_store, write_run

import fffo_drive as fd
from fffo_drive.documents import DocumentError
from fffo_drive.fleet import work as work_module
from fffo_drive.fleet.adding import Given, add_runs, runs_below
from fffo_drive.fleet.dask_engine import work_on_dask
from fffo_drive.fleet.place import StorePlace
from fffo_drive.fleet.schema import file_bytes
from fffo_drive.fleet.store import MOST_TRIES, FleetStore
from fffo_drive.fleet.work import StoreWriteError, make_record, shard_of, work

ANSWER_S = 30.0
AXIS = Path(__file__).resolve().parents[2] / "configs" / "axis_simulated.yaml"


@pytest.fixture(scope="session")
def six_runs(tmp_path_factory):
    """Paths of six short tables of one axis."""
    directory = tmp_path_factory.mktemp("six")
    return [write_run(directory / f"run{seed}.csv", seed) for seed in range(6)]


@pytest.fixture(scope="session")
def merged_bytes(six_runs, tmp_path_factory):
    """The store of the six runs, made in this process, one after the other."""
    store = filled_store(tmp_path_factory.mktemp("plain") / "store", six_runs)
    work(store.place.address, store.waiting(), workers=1)
    store.compact()
    return files_of(Path(store.place.address))


def merged(store):
    store.compact()
    return files_of(Path(store.place.address))


def test_a_place_that_does_not_answer_is_no_failure_of_the_file(six_runs, tmp_path):
    mounted = tmp_path / "mounted"
    mounted.mkdir()
    path = write_run(mounted / "run.csv", 60)
    store = filled_store(tmp_path / "store", [path])
    mounted.rename(tmp_path / "away")
    for _ in range(MOST_TRIES + 1):
        work(store.place.address, store.waiting(), workers=1)
    assert store.failures() == []
    assert store.status().waiting == 1
    (noted,) = store.unreached()
    assert "its directory is not there" in noted.reason
    (tmp_path / "away").rename(mounted)
    work(store.place.address, store.waiting(), workers=1)
    assert (store.status().recorded, store.unreached()) == (1, [])


def test_a_torn_recording_and_the_finished_file_made_of_it_are_one_run(six_runs, tmp_path):
    profile = tmp_path / "short.yaml"
    profile.write_text("profile: {kind: paper, duration_s: 4, seed: 9}\n")
    fd.run(AXIS, tmp_path / "run.mcap", toggle="ff", profile=profile)
    whole, torn = (tmp_path / "run.mcap").read_bytes(), tmp_path / "run.mcap.part"
    (tmp_path / "run.mcap").rename(tmp_path / "kept")
    torn.write_bytes(whole[: len(whole) * 3 // 4])
    store = FleetStore(str(tmp_path / "store"), create=True)
    given = Given("d1", "m1", None)
    assert add_runs(store, [str(torn)], given).new == 1
    work(store.place.address, store.waiting(), workers=1)
    assert store.status().recorded == 1
    store.compact()
    (tmp_path / "kept").rename(tmp_path / "run.mcap")
    assert add_runs(store, [str(tmp_path / "run.mcap")], given).new == 1
    assert add_runs(store, [str(torn)], given).new == 0
    assert store.status().runs == 1
    work(store.place.address, store.waiting(), workers=1)
    assert store.records(["path"]).column("path").to_pylist() == [str(tmp_path / "run.mcap")]


def test_processes_make_the_same_bytes(six_runs, merged_bytes, tmp_path):
    store = filled_store(tmp_path / "store", six_runs)
    shares = []
    work(store.place.address, store.waiting(), workers=2, progress=shares.append)
    assert shares == [pytest.approx(k / 6) for k in range(1, 7)]
    assert merged(store) == merged_bytes
    work(store.place.address, store.waiting(), workers=2)
    assert merged(store) == merged_bytes


def test_shares_are_disjoint_and_make_the_same_bytes(six_runs, merged_bytes, tmp_path):
    store = filled_store(tmp_path / "store", six_runs)
    everything = store.waiting()
    shares = [shard_of(everything, k, 3) for k in (1, 2, 3)]
    assert sorted(one["run"] for share in shares for one in share) == [one["run"] for one in everything]
    for share in reversed(shares):
        work(store.place.address, share, workers=1)
    assert merged(store) == merged_bytes


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # distributed's own, on shutting down
def test_a_cluster_of_dask_makes_the_same_bytes(six_runs, merged_bytes, tmp_path):
    store = filled_store(tmp_path / "store", six_runs)
    shares = []
    work_on_dask("local", store.place.address, store.waiting(), shares.append)
    assert shares[-1] == 1.0
    assert merged(store) == merged_bytes


@pytest.mark.filterwarnings("default")
def test_a_scheduler_that_does_not_answer_is_one_sentence(six_runs, tmp_path, monkeypatch):
    monkeypatch.setattr("fffo_drive.fleet.dask_engine.CONNECT_S", 0.3)
    with socket.socket() as nobody:
        nobody.bind(("127.0.0.1", 0))
        where = f"tcp://127.0.0.1:{nobody.getsockname()[1]}"
        with pytest.raises(DocumentError, match=r"dask:tcp.*no scheduler answers"):
            work_on_dask(where, str(tmp_path), [])


def test_a_worker_that_is_killed_loses_one_unit_which_is_made_again(six_runs, merged_bytes, tmp_path):
    store = filled_store(tmp_path / "store", six_runs)
    killed = []

    def kill(_share):
        if len(killed) < MOST_TRIES - 1:  # it may be the same unit each time, and one more would end its tries
            # one that was killed just now may still be listed
            victim = next(one for one in multiprocessing.active_children() if one.pid not in killed)
            os.kill(victim.pid, signal.SIGKILL)
            killed.append(victim.pid)

    work(store.place.address, store.waiting(), workers=2, progress=kill)
    assert len(set(killed)) == MOST_TRIES - 1
    assert merged(store) == merged_bytes


DYING = """
import os, signal, sys
from fffo_drive.fleet.store import FleetStore
from fffo_drive.fleet.work import work
def die(share):
    if share > 0.3:
        os.kill(os.getpid(), signal.SIGKILL)
if __name__ == "__main__":
    work(sys.argv[1], FleetStore(sys.argv[1]).waiting(), 2, die)
"""


@pytest.mark.slow
def test_who_hands_out_the_units_may_be_killed(six_runs, merged_bytes, tmp_path):
    store = filled_store(tmp_path / "store", six_runs)
    script = tmp_path / "dying.py"
    script.write_text(DYING)
    done = subprocess.run([sys.executable, str(script), store.place.address], check=False)
    assert done.returncode == -signal.SIGKILL
    assert store.status().recorded >= 2
    work(store.place.address, store.waiting(), workers=1)
    # a unit that was under way may have ended since, or left its try behind, which is no failure
    assert store.status().failed == 0
    made = {name: data for name, data in merged(store).items() if not name.startswith("failed/tries")}
    assert made == merged_bytes


def test_what_kills_its_workers_is_given_up_after_three(six_runs, tmp_path):
    store = filled_store(tmp_path / "store", six_runs[:1])
    (entry,) = store.waiting()
    for number in range(MOST_TRIES):
        assert store.begin_attempt(entry["run"], entry["path"]).number == number + 1  # and its worker dies
    make_record(store.place.address, entry)
    (failure,) = store.failures()
    assert failure.tries == 3
    assert "worker died" in failure.reason
    assert store.waiting() == []
    assert store.forgive() == 1
    work(store.place.address, store.waiting(), workers=1)
    assert store.status().recorded == 1


def test_poisoned_files_end_with_their_reason_and_stop_nobody(six_runs, merged_bytes, tmp_path):
    still = tmp_path / "short.csv"
    still.write_text("time_s,position_rev,current_command_a\n0,0,0\n0.002,0,0\n0.004,0,0\n")
    noise = tmp_path / "noise.csv"
    noise.write_bytes(bytes(range(256)) * 40)
    gone = write_run(tmp_path / "gone.csv", 50)
    changed = write_run(tmp_path / "changed.csv", 51)
    poisoned = [still, gone, changed]
    store = filled_store(tmp_path / "store", [*poisoned, *six_runs])
    (problem,) = add_runs(store, [str(noise)], Given("d1", "m1", FACTS)).problems  # it is no table at all
    assert str(noise) in problem
    gone.unlink()
    write_run(changed, 52)
    work(store.place.address, store.waiting(), workers=2)
    reasons = {failure.path: failure.reason for failure in store.failures()}
    assert set(reasons) == {str(path) for path in poisoned}
    assert all(failure.tries == 1 for failure in store.failures())  # another try would end as this one
    assert "No such file" in reasons[str(gone)]
    assert "has changed since it was added" in reasons[str(changed)]
    assert store.waiting() == []
    assert not store.place.files("failed/tries", "")
    store.compact()
    records = {name: data for name, data in merged_bytes.items() if name.startswith("records")}
    made = files_of(Path(store.place.address))
    assert {name: data for name, data in made.items() if name.startswith("records")} == records


def test_two_who_work_on_the_same_at_once_double_nothing(six_runs, merged_bytes, tmp_path):
    store = filled_store(tmp_path / "store", six_runs)
    entries = store.waiting()
    both = [
        threading.Thread(target=work, args=(store.place.address, order), kwargs={"workers": 1})
        for order in (entries, list(reversed(entries)))
    ]
    for one in both:
        one.start()
    for one in both:
        one.join()
    assert store.status().recorded == 6
    assert merged(store) == merged_bytes


def test_a_full_disk_ends_the_work_which_then_goes_on_where_it_was(six_runs, merged_bytes, tmp_path, monkeypatch):
    store = filled_store(tmp_path / "store", six_runs)
    write, left = StorePlace.write, [3]

    def full(self, name, data):
        if name.startswith("records") and left[0] == 0:
            raise OSError(errno.ENOSPC, "No space left on device", name)
        left[0] -= name.startswith("records")
        write(self, name, data)

    monkeypatch.setattr(StorePlace, "write", full)
    for _ in range(MOST_TRIES + 1):  # as often as one likes: no run is blamed for it
        with pytest.raises(StoreWriteError, match="No space left"):
            work(store.place.address, store.waiting(), workers=1)
    monkeypatch.undo()
    status = store.status()
    assert (status.recorded, status.failed, status.waiting) == (3, 0, 3)
    work(store.place.address, store.waiting(), workers=1)
    assert merged(store) == merged_bytes


def test_a_worker_whose_disk_is_full_tells_the_one_who_asked(six_runs, tmp_path):
    store = filled_store(tmp_path / "store", six_runs[:2])
    entries = store.waiting()
    (tmp_path / "store" / "records").write_text("a file where a directory should be")
    with pytest.raises(StoreWriteError):
        work(store.place.address, entries, workers=2)


def test_who_stops_the_work_leaves_no_try_behind(six_runs, tmp_path, monkeypatch):
    store = filled_store(tmp_path / "store", six_runs[:1])

    def stopped(_entry):
        raise KeyboardInterrupt

    monkeypatch.setattr(work_module, "record_row", stopped)
    with pytest.raises(KeyboardInterrupt):
        work(store.place.address, store.waiting(), workers=1)
    assert not store.place.files("failed", "")


# ---- S3


@pytest.fixture(scope="module")
def bucket(tmp_path_factory):
    """A bucket of an S3 server, a process on loopback; the environment names it."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    log = (tmp_path_factory.mktemp("s3") / "log").open("w")
    command = [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)]
    server = subprocess.Popen(command, stdout=log, stderr=log)
    variables = {
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{port}", "AWS_ACCESS_KEY_ID": "test", "AWS_SECRET_ACCESS_KEY": "test",
        "AWS_DEFAULT_REGION": "us-east-1", "AWS_EC2_METADATA_DISABLED": "true",
    }  # fmt: skip
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        _wait_for(server, port)
        import boto3

        boto3.client("s3").create_bucket(Bucket="fleet")
        yield "s3://fleet"
    finally:
        server.kill()
        server.wait()
        log.close()
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value


def _wait_for(server, port):
    """Until it answers, or has ended."""
    waited = threading.Event()
    for _ in range(int(ANSWER_S / 0.1)):
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1.0):
            return
        assert server.poll() is None, "the S3 server has ended"
        waited.wait(0.1)
    raise AssertionError("the S3 server does not answer")


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # botocore's own
def test_runs_and_store_may_be_in_a_bucket(bucket, six_runs, merged_bytes, tmp_path):
    runs = StorePlace(f"{bucket}/runs")
    for path in six_runs[:3]:
        runs.write(f"monday/{path.name}", path.read_bytes())
    runs.write("monday/notes.md", b"not a run")
    store = FleetStore(f"{bucket}/store", create=True)
    places = runs_below(f"{bucket}/runs", tables=True)
    assert places == [f"{bucket}/runs/monday/run{k}.csv" for k in range(3)]
    added = add_runs(store, places, Given("d1", "m1", FACTS))
    assert (added.new, added.problems) == (3, ())
    assert add_runs(store, places, Given("d1", "m1", FACTS)).new == 0
    runs.write("monday/bad.csv", b"no table")
    (problem,) = add_runs(store, [f"{bucket}/runs/monday/bad.csv"], Given("d1", "m1", FACTS)).problems
    assert f"{bucket}/runs/monday/bad.csv" in problem
    runs.write("monday/bad.csv", b"time_s,position_rev,current_command_a\n0,0,0\n0.002,0,0\n0.004,0,0\n")
    add_runs(store, [f"{bucket}/runs/monday/bad.csv"], Given("d1", "m1", FACTS))
    work(store.place.address, store.waiting(), workers=2)
    status = store.status()
    assert (status.recorded, status.failed, status.waiting) == (3, 1, 0)
    (failure,) = store.failures()
    assert failure.path == f"{bucket}/runs/monday/bad.csv"
    assert failure.path in failure.reason
    made = store.records().sort_by("run").combine_chunks()
    local = filled_store(tmp_path / "store", six_runs[:3])
    work(local.place.address, local.waiting(), workers=1)
    assert _numbers(made) == _numbers(local.records().sort_by("run"))
    assert store.compact().records == 3
    assert not store.place.files("records/new", "")
    assert _numbers(store.records().sort_by("run")) == _numbers(made)
    again = store.place.files("records", "")
    store.compact()
    assert store.place.files("records", "") == again


def _numbers(table):
    """All but where a run was, as bytes: NaN is NaN there."""
    return file_bytes(table.drop_columns(["path", "start"]))


def test_a_protocol_that_is_not_known_is_one_sentence():
    with pytest.raises(DocumentError, match="gopher://x/y"):
        StorePlace("gopher://x/y")
