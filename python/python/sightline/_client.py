"""The client of a coordinator, and the jobs of the coordinator."""

from __future__ import annotations

import json
import os
from typing import TYPE_CHECKING, Any, Dict, List, Optional

from . import _mesh, _options, _progress, _sightline, _work
from ._sightline import Pvs

if TYPE_CHECKING:
    from typing_extensions import Unpack


#: The options of a submission.
_SUBMISSION = {name: name for name in ("name", "user", "priority", "request_id")}


def _name(mesh: _mesh.MeshLike) -> str:
    """Returns the default name of a job: the name of the file, or "mesh"."""
    return os.path.basename(os.fsdecode(mesh)) if isinstance(mesh, (str, os.PathLike)) else "mesh"


class Client:
    """A coordinator, started with `sightline coordinator`.

        client = sightline.Client("http://127.0.0.1:7600")
        job = client.submit("level.glb", cells=(16, 4, 16))
        pvs = job.wait(progress=print).fetch()

    Each call opens a new connection, so a coordinator may restart between two calls. `connection` contains the paths
    of files with credentials: `ca` (the authority of the coordinator's certificate), `cert` and `key` (the client's
    own certificate), and `token_file`.
    """

    def __init__(self, url: str = "http://127.0.0.1:7600", **connection: _options.Path) -> None:
        known = ("ca", "cert", "key", "token_file")
        files = _options.values("Client", known, dict(connection), "")
        #: The address of the coordinator.
        self.url = url
        self._native = _sightline.Client(url, json.dumps(files))

    def submit(
        self,
        mesh: _mesh.MeshLike,
        *,
        name: Optional[str] = None,
        user: Optional[str] = None,
        priority: int = 0,
        request_id: Optional[str] = None,
        **options: Unpack[_options.JobOptions],
    ) -> Job:
        """Uploads a mesh and submits a job. Accepts the meshes and options of `bake`. If the coordinator already has
        a job with the same mesh and options, returns that job (`Job.existing`).

        name: the name of the job. Default: the name of the file.
        user: the owner of the job for fair shares. Default: the login name.
        priority: -1000 to 1000; jobs with a higher priority receive workers first. Default: 0.
        request_id: an identifier that makes a repeated submission safe: the same text gives the same job.
        """
        given: Dict[str, Any] = {"name": name, "user": user, "priority": priority, "request_id": request_id, **options}
        known = (*_options.JobOptions.__annotations__, *_SUBMISSION)
        with _options.folder() as folder:
            job = _options.values("submit", known, given, folder)
            scene, traces = _options.scene(job), _options.traces(job)
            submission = {"name": _name(mesh), **_options.take(job, _SUBMISSION)}
            document = _options.document(scene=scene, job=job, submission=submission, traces=traces)
            told, existing = self._native.submit(_mesh.source(mesh), document)
        return Job(self, json.loads(told), existing)

    def jobs(self, *, limit: Optional[int] = None, before: Optional[int] = None) -> List[Job]:
        """Returns the newest jobs, ascending by number: at most `limit` (default 100), older than the job `before`."""
        return [Job(self, json.loads(told), True) for told in self._native.jobs(limit, before)]

    def job(self, number: int) -> Job:
        """Returns the job with this number."""
        return Job(self, json.loads(self._native.show(number)), True)

    def __repr__(self) -> str:
        return f"<sightline.Client of {self.url}>"


class Job:
    """A job of a coordinator."""

    def __init__(self, client: Client, info: Dict[str, Any], existing: bool) -> None:
        self._client = client
        #: The last received state, with the fields of `sightline show --json`. `refresh` updates it.
        self.info = info
        #: True if the job existed before the submission.
        self.existing = existing

    @property
    def number(self) -> int:
        """The job's number at its coordinator."""
        return int(self.info["job"])

    @property
    def state(self) -> str:
        """The current state: queued, running, paused, cancelled, failed or done. Queries the coordinator."""
        return str(self.refresh().info["state"])

    def refresh(self) -> Job:
        """Requests the current `info` from the coordinator."""
        return self._heard(self._client._native.show(self.number))

    def wait(self, progress: Optional[_progress.OnProgress] = None) -> Job:
        """Waits until the job is done. Raises JobError if the job fails or is cancelled. Ctrl-C and exceptions of
        `progress` end the waiting, but not the job."""
        return self._heard(self._client._native.wait(self.number, _progress.caller(progress)))

    def fetch(self, path: Optional[_options.Path] = None) -> Pvs:
        """Downloads the result of a finished job and returns the result. Stores the file at `path`, if given."""
        if path is not None:
            self._client._native.fetch(self.number, os.fspath(path))
            return Pvs(path)
        with _options.folder() as folder:
            file = os.path.join(folder, "result.pvs")
            self._client._native.fetch(self.number, file)
            return _work._read(file)

    def cancel(self) -> Job:
        """Cancels the job. The coordinator keeps its finished tiles for `retry`."""
        return self._act("cancel")

    def pause(self) -> Job:
        """Pauses the job. Workers finish the tiles that they have begun."""
        return self._act("pause")

    def resume(self) -> Job:
        """Continues a paused job."""
        return self._act("resume")

    def retry(self) -> Job:
        """Continues a failed or cancelled job, or bakes again the tiles that a finished job has set aside."""
        return self._act("retry")

    def prioritize(self, priority: int) -> Job:
        """Changes the priority of the job, -1000 to 1000."""
        return self._heard(self._client._native.prioritize(self.number, priority))

    def _act(self, action: str) -> Job:
        return self._heard(self._client._native.act(self.number, action))

    def _heard(self, told: str) -> Job:
        self.info = json.loads(told)
        return self

    def __repr__(self) -> str:
        return f"<sightline.Job {self.number} {self.info['name']}: {self.info['state']}>"
