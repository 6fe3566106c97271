"""Scenes that visitors bring: a file is received, encoded by a process of its own, and served among the others.

One job at a time, for those who may: whoever knows the token, or this machine's user where there is none. A file's name
is used for its suffix and for a title, never for a place.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

from aiohttp import web

from cags_common.errors import CagsError, ConfigError
from cags_common.transport.hosts import named
from cags_server.http.admission import header_allowed, origin_allowed
from cags_server.http.gallery.archives import frame_names, unpacked
from cags_server.scene.collection import Collection, scene_name
from cags_server.settings import ServeSettings

SUFFIXES = (".ply", ".spz", ".splat", ".sog", ".splatv", ".npz", ".zip")
STILL = (".spz", ".splat", ".sog")
"""Formats of one moment."""
UNPACKED = 4
"""An archive may hold so many times what may be sent."""
PREFIX = ".upload-"
CHUNK_BYTES = 1 << 20
QUIET_S = 30.0
"""Time without a byte after which an upload is given up."""
NICENESS = 10
"""Of the encoder: viewers come first."""
MAX_LINE = 300
ENDED = "the upload was ended"
_PROGRESS = re.compile(r"(\D{1,60}): (\d{1,9}) of (\d{1,9})", re.ASCII)

log = logging.getLogger(__name__)


class UploadError(CagsError):
    """Why a file is not taken, or did not become a scene."""

    def __init__(self, text: str, status: int = 413) -> None:
        """``status``: of the HTTP answer."""
        super().__init__(text)
        self.status = status


@dataclass(frozen=True, slots=True)
class Job:
    """The job under way, or the last one."""

    state: str = "idle"
    """``idle``, ``receiving``, ``encoding``, ``done`` or ``failed``."""
    text: str = ""
    """Status to display, one line."""
    share: float | None = None
    """Progress of the stage that ``text`` names, 0..1; None while unknown."""
    scene: str = ""
    """The name of the scene that has come of it."""


class Uploads:
    """``/upload``: POST ``?name=`` a file, GET the job's state, DELETE to end it."""

    def __init__(self, scenes: Collection, settings: ServeSettings, streams: Callable[[web.Request], None]) -> None:
        """``streams`` is told of requests that take their time. Raises :class:`ConfigError` without a folder."""
        if scenes.folder is None:
            raise ConfigError(f"accept_uploads: bundle = {settings.bundle} is one bundle; give a folder for several")
        self._scenes, self._settings, self._streams, self._folder = scenes, settings, streams, scenes.folder
        self._most = round(settings.upload_mb * 1e6)
        self.job = Job()
        self._work: asyncio.Task[None] | None = None  # receives, then encodes
        self._place: Path | None = None  # of the job under way
        self._closed = False
        for left in self._folder.glob(f"{PREFIX}*"):  # of a server that was killed
            shutil.rmtree(left, ignore_errors=True)

    def add_routes(self, app: web.Application) -> None:
        """Take, tell and end."""
        app.router.add_post("/upload", self._post)
        app.router.add_get("/upload", self._get)
        app.router.add_delete("/upload", self._delete)

    async def close(self) -> None:
        """End what is under way, and take nothing more."""
        self._closed = True
        await self.end()

    async def end(self) -> None:
        """End what is under way: a file that is being received, or one that is being encoded."""
        work, self._work = self._work, None
        place = self._place
        if work is None or place is None:
            return
        work.cancel()
        await asyncio.gather(work, return_exceptions=True)
        if self._place is place:  # it was being received, or had not begun to be encoded
            self._ended(asyncio.CancelledError())

    async def _get(self, request: web.Request) -> web.Response:
        return self._refusal(request) or web.json_response(asdict(self.job))

    async def _delete(self, request: web.Request) -> web.Response:
        refusal = self._refusal(request)
        if refusal is not None:
            return refusal
        await self.end()
        return web.json_response(asdict(self.job))

    async def _post(self, request: web.Request) -> web.Response:
        refusal = self._refusal(request)
        if refusal is not None:
            return refusal
        try:
            await self._take(request)
        except UploadError as error:
            return _error(error.status, str(error))
        return web.json_response(asdict(self.job), status=202)

    async def _take(self, request: web.Request) -> None:
        """Receive a file and begin to encode it. Raises :class:`UploadError`."""
        name = request.query.get("name", "")
        suffix = next((end for end in SUFFIXES if name.lower().endswith(end)), None)
        if suffix is None:
            known = ", ".join(SUFFIXES)
            raise UploadError(f"{name[-60:]!r}: is of no kind that is encoded; known are {known}", 415)
        if (request.content_length or 0) > self._most:
            raise UploadError(f"{request.content_length} bytes are more than the {self._most} that are taken")
        if self._closed:
            raise UploadError("the server is shutting down", 503)
        if self._place is not None:
            raise UploadError("another file is being encoded; try again when it is done", 409)
        self._streams(request)
        self._place = place = Path(tempfile.mkdtemp(prefix=PREFIX, dir=self._folder))
        file = place / f"{scene_name(name[: -len(suffix)])}{suffix}"
        receiving = self._work = asyncio.create_task(self._receive(request, file))
        try:
            await self._awaited(receiving)
        except BaseException as error:
            if self._work is receiving:  # else `end` tells how it ended
                self._ended(error)
            if isinstance(error, OSError | web.RequestPayloadError):  # its sender is gone, or there is no room
                raise UploadError(f"the file was not received ({error})", 507) from error
            raise
        self._work = asyncio.create_task(self._run(place, _title(name[: -len(suffix)])))

    async def _awaited(self, receiving: asyncio.Task[None]) -> None:
        """Wait for a file. Raises what :meth:`_receive` does, and :class:`UploadError` if :meth:`end` ended the upload,
        even if the last byte had just come.
        """
        try:
            await asyncio.wait({receiving})
        finally:
            receiving.cancel()  # where the request itself is cancelled
        if self._work is not receiving:
            raise UploadError(ENDED, 409)
        await receiving

    def _refusal(self, request: web.Request) -> web.Response | None:
        if not header_allowed(self._settings.token, request.headers.get("Authorization")):
            return _error(401, "the token is missing or wrong")
        origin, host = request.headers.get("Origin"), request.headers.get("Host")
        if not origin_allowed(origin, host, self._settings.origins, named(self._settings.hosts)):
            return _error(403, f"origin {origin} is not allowed; list it with --origins")
        return None

    async def _receive(self, request: web.Request, file: Path) -> None:
        """Write the request's body. Raises :class:`UploadError` for one that is too large or stops coming."""
        self.job, got, whole = Job("receiving", "Receiving"), 0, request.content_length
        with file.open("wb") as out:
            while True:
                try:
                    async with asyncio.timeout(QUIET_S):
                        data = await request.content.read(CHUNK_BYTES)
                except TimeoutError:
                    raise UploadError(f"nothing came for {QUIET_S:g} s; send the file again") from None
                if not data:
                    return
                got += len(data)
                if got > self._most:
                    raise UploadError(f"the file is larger than the {self._most} bytes that are taken")
                await asyncio.to_thread(out.write, data)
                self.job = Job("receiving", "Receiving", got / whole if whole else None)

    async def _run(self, place: Path, title: str) -> None:
        """Encode the file in ``place``, and serve what comes of it."""
        try:
            async with asyncio.timeout(self._settings.upload_minutes * 60):
                bundle = await self._encoded(place, title)
            target = self._folder / _free(self._folder, bundle.name)
            bundle.rename(target)
            name = await asyncio.to_thread(self._scenes.add, target)
            self._ended(None)
            self.job = Job("done", f"{title} is ready", 1.0, name)
            log.info("upload: %s is served as %s", title, name)
        except BaseException as error:
            self._ended(error)
            if not isinstance(error, CagsError | TimeoutError | OSError):
                raise

    async def _encoded(self, place: Path, title: str) -> Path:
        """The bundle of the one file in ``place``. Raises :class:`UploadError`."""
        self.job = Job("encoding", "Reading the file")
        file = next(iter(await asyncio.to_thread(_listed, place)))
        scene = str(file)
        if file.suffix == ".zip":
            scene = str(await asyncio.to_thread(unpacked, file, place / file.stem, UNPACKED * self._most))
        elif await asyncio.to_thread(_is_still, file):
            scene += ":frames=1"
        view, bundle = place / "view.json", place / f"{file.stem}.cags"
        view.write_text(json.dumps({"title": title}))
        command = [sys.executable, "-m", "cags_encoder", scene, str(bundle), "--view", str(view), "--no-resume"]
        process = await asyncio.create_subprocess_exec(
            *command, "--workers", "1", stdout=asyncio.subprocess.DEVNULL, stderr=asyncio.subprocess.PIPE
        )
        if sys.platform == "linux":
            os.setpriority(os.PRIO_PROCESS, process.pid, NICENESS)
        try:
            last = await self._follow(process)
            if await process.wait():
                told = last.replace(f"{place}/", "").removeprefix("cags-encode: ")
                told = told.replace(file.name, f"{title}{file.suffix}", 1)
                if file.suffix == ".zip":
                    told = _as_sent(told, file.stem, frame_names(file, UNPACKED * self._most))
                raise UploadError(told or "the encoder failed")
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
        return bundle

    async def _follow(self, process: asyncio.subprocess.Process) -> str:
        """Take the encoder's lines as they come; the last of them."""
        assert process.stderr is not None
        last = ""
        while True:
            try:
                line = await process.stderr.readline()
            except ValueError:  # longer than any that is meant for people
                continue
            if not line:
                return last
            last = line.decode(errors="replace").strip()[:MAX_LINE]
            if match := _PROGRESS.fullmatch(last):
                stage, done, total = match[1], int(match[2]), int(match[3])
                self.job = Job("encoding", stage.capitalize(), min(done / max(total, 1), 1.0))

    def _ended(self, error: BaseException | None) -> None:
        if self._place is not None:
            shutil.rmtree(self._place, ignore_errors=True)
        self._place = None
        if error is None:
            return
        reason = {asyncio.CancelledError: ENDED, TimeoutError: "encoding took too long"}.get(type(error), str(error))
        self.job = Job("failed", reason.splitlines()[0][:MAX_LINE] if reason else type(error).__name__)
        log.warning("upload: %s", self.job.text)


def _listed(folder: Path) -> list[Path]:
    return list(folder.iterdir())


def _is_still(file: Path) -> bool:
    """Whether a file holds one moment, of which one frame says everything."""
    if file.suffix in STILL:
        return True
    with file.open("rb") as data, contextlib.suppress(OSError):
        return file.suffix == ".ply" and b"trbf_center" not in data.read(1 << 16)  # SpaceTime Gaussians have it
    return False


def _as_sent(text: str, folder: str, frames: list[str]) -> str:
    """A message with the frames' own names, instead of those that they were unpacked to in ``folder``."""

    def own(match: re.Match[str]) -> str:
        number = int(match[1])
        return "".join(c for c in frames[number] if c.isprintable())[-60:] if number < len(frames) else match[0]

    return re.sub(rf"{re.escape(folder)}/([0-9]{{5}})\.[a-z]+", own, text)


def _title(text: str) -> str:
    """A file's name for people."""
    plain = "".join(c for c in re.sub(r"[_\s]+", " ", text.rpartition("/")[2]) if c.isprintable()).strip()[:120]
    return plain or "Scene"


def _free(folder: Path, name: str) -> str:
    """``name``, with a number where the folder has it."""
    stem, number, found = name.removesuffix(".cags"), 1, name
    while (folder / found).exists():
        number += 1
        found = f"{stem}-{number}.cags"
    return found


def _error(status: int, text: str) -> web.Response:
    return web.json_response({"error": text}, status=status)
