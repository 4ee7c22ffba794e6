"""Jobs at a coordinator, from submission to result."""

import subprocess

import pytest
from conftest import boxes

import sightline

TOWN = boxes([[x, 0, z] for x in range(0, 12, 3) for z in range(0, 12, 3)])
JOB = {"cells": (4, 1, 4), "backend": "cpu"}


class Cluster:
    def __init__(self, program, folder):
        self.program, self.processes = program, []
        serve = self.start("coordinator", "--listen", "127.0.0.1:0", "--data-dir", str(folder))
        self.url = serve.stdout.readline().split()[-1]

    def start(self, *words):
        process = subprocess.Popen(
            [self.program.binary, *words], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        self.processes.append(process)
        return process

    def worker(self):
        return self.start("worker", "--coordinator", self.url, "--backend", "cpu", "--threads", "1")


@pytest.fixture
def cluster(program, tmp_path):
    cluster = Cluster(program, tmp_path / "data")
    yield cluster
    for process in cluster.processes:
        process.kill()
        process.wait()


def test_a_job_is_submitted_followed_and_fetched(cluster, tmp_path):
    client = sightline.Client(cluster.url)
    job = client.submit(TOWN, name="town", user="ann", **JOB)
    assert job.state == "queued" and not job.existing and job.info["user"] == "ann"
    cluster.worker()
    told = []
    assert job.wait(progress=told.append) is job
    assert job.info["state"] == "done" and told[-1].done == told[-1].total == 16
    pvs = job.fetch()
    # The cluster and this process give the same bytes.
    assert pvs.to_bytes() == sightline.bake(TOWN, **JOB).to_bytes()
    assert job.fetch(tmp_path / "town.pvs").to_bytes() == (tmp_path / "town.pvs").read_bytes() == pvs.to_bytes()
    again = client.submit(TOWN, **JOB)
    assert again.existing and again.number == job.number


def test_a_job_is_paused_continued_and_ended(cluster):
    client = sightline.Client(cluster.url)
    job = client.submit(TOWN, **JOB)
    other = client.submit(TOWN, priority=3, seed=1, **JOB)
    assert [j.number for j in client.jobs()] == [job.number, other.number]
    assert client.jobs(before=other.number)[0].number == job.number
    assert job.pause().info["state"] == "paused" and job.state == "paused"
    assert job.resume().info["state"] == "queued"
    assert client.job(other.number).prioritize(7).info["priority"] == 7
    assert job.cancel().info["state"] == "cancelled"
    with pytest.raises(sightline.JobError, match="cancelled"):
        job.wait()
    with pytest.raises(sightline.JobError):
        job.fetch()
    assert job.retry().info["state"] == "queued"
    with pytest.raises(sightline.CoordinatorError, match="has not ended"):
        job.fetch()


def test_a_coordinator_that_is_not_there_is_named():
    client = sightline.Client("http://127.0.0.1:9")
    with pytest.raises(sightline.CoordinatorError, match="no coordinator answers at http://127.0.0.1:9"):
        client.jobs()
    with pytest.raises(TypeError, match="Client has no option nonsense"):
        sightline.Client("http://127.0.0.1:9", nonsense="x")
    with pytest.raises(TypeError, match="submit has no option cell"):
        client.submit(TOWN, cell=3)
