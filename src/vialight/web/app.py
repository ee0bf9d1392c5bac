"""The server's addresses and what answers them."""

from __future__ import annotations

import asyncio
import json
import os
from collections.abc import AsyncIterator, Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import Any, TypeVar

from starlette.applications import Starlette
from starlette.convertors import Convertor, register_url_convertor
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp
from starlette.websockets import WebSocket

from vialight.core.errors import InputError
from vialight.web.access import Access
from vialight.web.catalogue import DOWNLOADS, Catalogue, unreadable, with_state
from vialight.web.gate import Gate, let_in
from vialight.web.orders import OrderDesk, check_order
from vialight.web.readers import CannotBeReadError, Readers, Told
from vialight.web.runs import CannotTellError, Run, find_print, own_file, printable
from vialight.web.slices import LiveSlices
from vialight.web.sockets import MOST_SOCKETS, refuse_socket, serve_socket
from vialight.web.timelapses import TimeLapses
from vialight.web.watching import CHANNELS, RunWatch

_T = TypeVar("_T")
_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}
_REPORT_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; frame-ancestors 'none'; sandbox"
"""A report has its style inside; it needs no script, and gets none even if one had found its way in."""
_BINARY = "application/octet-stream"
_KEPT_IDLE = 3
"""Runs without a page whose newest pictures are still kept."""
_LIST_WITHIN_S = 3.0
"""For the list of runs; what is not read by then is told to be missing."""


class _Number(Convertor[int]):
    """A number in an address: of so many digits that it can be one of ours."""

    regex = "[0-9]{1,9}"

    def convert(self, value: str) -> int:
        return int(value)

    def to_string(self, value: int) -> str:
        return str(value)


register_url_convertor("number", _Number())


class _JsonResponse(JSONResponse):
    """JSON that can be sent whatever names there are: of one that is not UTF-8, as much as can be shown."""

    def render(self, content: Any) -> bytes:
        return json.dumps(content, ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode(
            "utf-8", "replace"
        )


def static_files() -> dict[str, tuple[bytes, str]]:
    """Read the page's own files: address to content and media type.  A request picks one of these, or nothing."""
    found: dict[str, tuple[bytes, str]] = {}

    def gather(folder: Traversable, prefix: str) -> None:
        for item in folder.iterdir():
            if item.is_dir():
                gather(item, f"{prefix}{item.name}/")
            elif (kind := _TYPES.get(os.path.splitext(item.name)[1])) is not None:  # noqa: PTH122
                found[prefix + item.name] = item.read_bytes(), kind

    gather(files("vialight.web") / "static", "/static/")
    found["/"] = found.pop("/static/index.html")
    found["/favicon.ico"] = found["/static/icon.svg"]
    return found


@dataclass
class _Shown:
    """A run with what is kept of it."""

    watch: RunWatch
    slices: LiveSlices
    sockets: int = 0


@dataclass
class PageServer:
    """What the addresses share.

    Parameters
    ----------
    catalogue
        The runs.
    access
        Who is let in.
    """

    catalogue: Catalogue
    access: Access
    desk: OrderDesk = field(default_factory=OrderDesk)
    timelapses: TimeLapses = field(default_factory=TimeLapses)
    readers: Readers = field(default_factory=Readers)
    workers: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(2, "page"))
    """For what is published by prints that run; what lies in folders is for `readers`."""
    looking: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(2, "look"))
    """For which folders and files there are, and which of them are linked to a print that runs."""
    _shown: dict[str, _Shown] = field(default_factory=dict)

    def app(self) -> ASGIApp:
        """Return the whole application, with its gate in front."""
        static = static_files()
        public = {("GET", path) for path in static} | {("HEAD", path) for path in static} | {("POST", "/api/session")}

        async def give_static(request: Request) -> Response:
            content, kind = static[request.url.path]
            return Response(content, media_type=kind, headers={"Cache-Control": "no-cache"})

        of_run = "/api/runs/{run}"
        routes = [
            *(Route(path, give_static, methods=["GET"]) for path in static),
            Route("/api/session", self.ask_session, methods=["GET"]),
            Route("/api/session", self.open_session, methods=["POST"]),
            Route("/api/runs", self.list_runs, methods=["GET"]),
            Route(of_run, self.show_run, methods=["GET"]),
            Route(of_run + "/curves/{start:number}", self.show_curves, methods=["GET"]),
            Route(of_run + "/log/{start:number}", self.show_log, methods=["GET"]),
            Route(of_run + "/moments/{number:number}", self.show_moment, methods=["GET"]),
            Route(of_run + "/moments/{number:number}/camera", self.show_recorded_picture, methods=["GET"]),
            Route(of_run + "/moments/{number:number}/pattern", self.show_recorded_pattern, methods=["GET"]),
            Route(of_run + "/slices/{x:number}/{y:number}/{z:number}", self.show_slices, methods=["GET"]),
            Route(of_run + "/surfaces/{number:number}", self.show_surface, methods=["GET"]),
            Route(of_run + "/reference", self.show_reference, methods=["GET"]),
            Route(of_run + "/reference-sums", self.show_reference_sums, methods=["GET"]),
            Route(of_run + "/thumbnail", self.show_thumbnail, methods=["GET"]),
            Route(of_run + "/report", self.show_report, methods=["GET"]),
            Route(of_run + "/files/{name}", self.download, methods=["GET"]),
            Route(of_run + "/timelapse", self.ask_timelapse, methods=["GET"]),
            Route(of_run + "/timelapse", self.make_timelapse, methods=["POST"]),
            Route(of_run + "/timelapse.mp4", self.give_timelapse, methods=["GET"]),
            Route(of_run + "/orders", self.take_order, methods=["POST"]),
            Route(of_run + "/stop", self.take_stop, methods=["POST"]),
            WebSocketRoute("/ws/{run}/{channel}", self.open_socket),
        ]
        handlers: dict[Any, Any] = {
            InputError: _tell_input_error,
            CannotTellError: _tell_for_want,
            CannotBeReadError: _tell_for_want,
            HTTPException: _tell_http_error,
        }
        inner = Starlette(routes=routes, exception_handlers=handlers, lifespan=self._lifespan)
        return Gate(inner, self.access, lambda method, path: (method, path) in public)

    @asynccontextmanager
    async def _lifespan(self, app: Starlette) -> AsyncIterator[None]:
        self.readers.start()
        yield
        for shown in self._shown.values():
            await shown.watch.stop()
        self.desk.close()
        self.timelapses.close()
        self.readers.close()
        self.workers.shutdown(wait=False)
        self.looking.shutdown(wait=False)

    async def _look(self, function: Callable[..., _T], *arguments: Any) -> _T:
        return await asyncio.get_running_loop().run_in_executor(self.looking, function, *arguments)

    def _run(self, request: Request | WebSocket) -> Run:
        run = self.catalogue.get(request.path_params["run"])
        if run is None:
            raise HTTPException(404, "no such run")
        return run

    def _of(self, run: Run) -> _Shown:
        if run.key not in self._shown:
            for key in [key for key, shown in self._shown.items() if not shown.sockets][:-_KEPT_IDLE]:
                del self._shown[key]
            watch = RunWatch(run, self.readers, self.workers, self.looking)
            self._shown[run.key] = _Shown(watch, LiveSlices())
        return self._shown[run.key]

    async def ask_session(self, request: Request) -> Response:
        """Say that the page is let in: otherwise the gate has answered."""
        told = {"name": printable(self.catalogue.root.name), "single": self.catalogue.is_single}
        return _JsonResponse(told | {"stop_port": self.access.stop_port})

    async def open_session(self, request: Request) -> Response:
        """Take the token and give a cookie."""
        given = await _json_of(request)
        token = given.get("token") if isinstance(given, dict) else None
        if not isinstance(token, str) or not self.access.is_token(token):
            return self._refuse_token(request.client.host if request.client else "", is_given=isinstance(token, str))
        let_in(request.scope)
        response = Response(status_code=204)
        response.set_cookie(
            self.access.cookie_name, self.access.cookie_value, httponly=True, samesite="strict", path="/",
            max_age=30 * 86400,
        )  # fmt: skip
        return response

    def _refuse_token(self, address: str, *, is_given: bool) -> Response:
        """Answer a token that is wrong, or none: who has tried too many has to wait, but never the right one."""
        wait_s = self.access.limit.wait_s(address)
        if wait_s > 0:
            return _error(429, f"too many wrong tokens; wait {wait_s:.0f} s", {"Retry-After": str(int(wait_s) + 1)})
        if not is_given:
            return _error(400, 'no token; accepted: {"token": "..."}')
        self.access.limit.fail(address)
        return _error(401, "wrong token")

    async def list_runs(self, request: Request) -> Response:
        """List the runs, newest first."""
        runs = await self._look(self.catalogue.refresh)
        asked = {run.key: asyncio.create_task(self._overview(run)) for run in runs}
        if asked:
            await asyncio.wait(asked.values(), timeout=_LIST_WITHIN_S)
        told = [
            task.result() if (task := asked[run.key]).done() else unreadable(run, "is still being read")
            for run in runs
        ]  # fmt: skip
        return _JsonResponse(told)

    async def _overview(self, run: Run) -> dict[str, Any]:
        try:
            told = (await self.readers.ask(run, "overview")).value
        except InputError as error:
            told = unreadable(run, _without_paths(str(error)))
        return await self._with_state(run, told)

    async def _with_state(self, run: Run, told: dict[str, Any]) -> dict[str, Any]:
        try:
            is_live = await self._look(find_print, run) is not None
        except CannotTellError:
            is_live = None
        return with_state(told, is_live=is_live)

    async def show_run(self, request: Request) -> Response:
        """Tell what a run is."""
        run = self._run(request)
        return _JsonResponse(await self._with_state(run, (await self.readers.ask(run, "summary")).value))

    async def show_curves(self, request: Request) -> Response:
        """Tell the numbers of a run's moments."""
        return await self._read(request, "curves", request.path_params["start"])

    async def show_log(self, request: Request) -> Response:
        """Tell the run's log from an event on."""
        return await self._read(request, "log", request.path_params["start"])

    async def show_moment(self, request: Request) -> Response:
        """Give the pictures of a moment."""
        return await self._read(request, "moment", request.path_params["number"])

    async def show_recorded_picture(self, request: Request) -> Response:
        """Give the camera's picture of a moment."""
        return await self._read(request, "recorded_picture", request.path_params["number"])

    async def show_recorded_pattern(self, request: Request) -> Response:
        """Give what was projected at a moment."""
        return await self._read(request, "recorded_pattern", request.path_params["number"])

    async def show_slices(self, request: Request) -> Response:
        """Give the slices at thousandths of the volume's extent."""
        run = self._run(request)
        place = [request.path_params[name] for name in "xyz"]
        link = await self._look(find_print, run)
        if link is None:
            return await self._read(request, "slices", *place)
        slices = self._of(run).slices
        cut = asyncio.get_running_loop().run_in_executor(self.workers, slices.at, link, *place)
        return Response(await cut, media_type=_BINARY)

    async def show_surface(self, request: Request) -> Response:
        """Give a surface of the history."""
        return await self._read(request, "surface", request.path_params["number"])

    async def show_reference(self, request: Request) -> Response:
        """Give the surface that is meant."""
        return await self._read(request, "reference")

    async def show_reference_sums(self, request: Request) -> Response:
        """Give the reference's projections."""
        return await self._read(request, "reference_sums")

    async def show_thumbnail(self, request: Request) -> Response:
        """Give a small picture of the print."""
        try:
            is_live = await self._look(find_print, self._run(request)) is not None
        except CannotTellError:
            is_live = True
        return await self._read(request, "thumbnail", is_live, kind="image/png")

    async def _read(self, request: Request, what: str, *arguments: Any, kind: str = _BINARY) -> Response:
        told: Told = await self.readers.ask(self._run(request), what, *arguments)
        if told.content is None:
            raise HTTPException(404, "there is none")
        return Response(told.content, media_type="application/json" if told.is_json else kind)

    async def show_report(self, request: Request) -> Response:
        """Give the finished print's report, as a page that may do nothing."""
        path = await self._look(own_file, self._run(request).folder, DOWNLOADS["report.html"][0])
        if path is None:
            raise HTTPException(404, "there is no report yet")
        return FileResponse(path, media_type="text/html", headers={"Content-Security-Policy": _REPORT_POLICY})

    async def download(self, request: Request) -> Response:
        """Give a file of the run, one of those that there are names for."""
        run = self._run(request)
        file, kind = DOWNLOADS.get(request.path_params["name"], ("", ""))
        path = await self._look(own_file, run.folder, file) if file else None
        if path is None:
            raise HTTPException(404, "no such file")
        name = f"{run.name}-{file}"
        return FileResponse(path, media_type=kind, filename=name, content_disposition_type="attachment")

    async def ask_timelapse(self, request: Request) -> Response:
        """Tell how far the time-lapse is."""
        return _JsonResponse(self.timelapses.state(self._run(request)))

    async def make_timelapse(self, request: Request) -> Response:
        """Begin to draw the time-lapse."""
        return _JsonResponse(self.timelapses.begin(self._run(request)))

    async def give_timelapse(self, request: Request) -> Response:
        """Give the finished time-lapse."""
        run = self._run(request)
        path = self.timelapses.finished(run)
        if path is None:
            raise HTTPException(404, "it has not been made")
        return FileResponse(path, media_type="video/mp4", filename=f"{run.name}-timelapse.mp4")

    async def take_order(self, request: Request) -> Response:
        """Pass an order on to the print."""
        order = check_order(await _json_of(request))
        return _JsonResponse(await self.desk.obey(self._run(request), order, _who(request)))

    async def take_stop(self, request: Request) -> Response:
        """Stop the print; needs no body, so that any program can do it."""
        return _JsonResponse(await self.desk.obey(self._run(request), {"do": "stop"}, _who(request)))

    async def open_socket(self, socket: WebSocket) -> None:
        """Feed a page."""
        run, channel = self.catalogue.get(socket.path_params["run"]), socket.path_params["channel"]
        if run is None or channel not in CHANNELS:
            await socket.close(1008)
            return
        if sum(shown.sockets for shown in self._shown.values()) >= MOST_SOCKETS:
            await refuse_socket(socket, "too many pages are open; close some")
            return
        shown = self._of(run)
        shown.sockets += 1
        shown.watch.start()
        try:
            await serve_socket(socket, shown.watch, channel, self.desk)
        finally:
            shown.sockets -= 1
            if not shown.sockets:
                await shown.watch.stop()


def _who(request: Request) -> str:
    return f"page at {request.client.host if request.client else 'unknown'}"


async def _json_of(request: Request) -> Any:
    try:
        return json.loads(await request.body())
    except (ValueError, RecursionError):
        return None


def _error(status: int, why: str, headers: dict[str, str] | None = None) -> Response:
    return _JsonResponse({"error": why}, status, headers)


async def _tell_input_error(request: Request, error: Exception) -> Response:
    return _error(409 if request.method == "POST" else 404, _without_paths(str(error)))


async def _tell_for_want(request: Request, error: Exception) -> Response:
    return _error(503, _without_paths(str(error)))


async def _tell_http_error(request: Request, error: Exception) -> Response:
    known = error if isinstance(error, HTTPException) else HTTPException(500)
    return _error(known.status_code, known.detail)


def _without_paths(text: str) -> str:
    """Leave folders of this machine out of what is told to a page."""
    return " ".join(word.rsplit("/", 1)[-1] if word.startswith("/") else word for word in text.split(" "))
