"""The studio's HTTP interface: routes, what they take, and errors in flysid's own words."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import importlib
import json
import sys
import threading
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from functools import cached_property
from importlib import resources
from mimetypes import guess_type
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, Response, StreamingResponse
from starlette.routing import Route

import flysid
from flysid.errors import FlysidError, WriteError
from flysid.studio import commands, forms
from flysid.studio.folders import NotThere, Workspace
from flysid.studio.guard import Quiet, RequestBounds, RequestGuard
from flysid.studio.jobs import Job, Jobs
from flysid.studio.live_stream import Live, seen_by, stream
from flysid.studio.loopback import Key
from flysid.studio.warm import Warm

if TYPE_CHECKING:
    from flysid.studio.channels import Recipes
    from flysid.studio.flights import Flights
    from flysid.studio.reviews import Reviews
    from flysid.studio.spectra import Spectra

ROOMS = ("flights", "uploads", "quick_look", "reviews", "spectra", "channels", "run_views", "explain")
"""What is imported while the page opens, in this order."""
FRAME_POLICY = "sandbox allow-scripts; frame-ancestors 'self'"
UPLOT = ("uPlot.iife.min.js", "uPlot.min.css")  # of the report, which the studio uses too
QUIET_S = 1.0  # an address that was printed is asked for within this; a page is drawn when it has asked all
SILENCE_S = 10.0  # an event stream says something at least this often
Handler = Callable[[Request], Awaitable[Response]]
Where = Mapping[str, str]
Look = Callable[[Where, Any], object]
"""What is found by the names in an address, and by the query as a form."""


class Studio:
    """The handlers; each answers one route.

    What reads tables or models is imported by one thread once the address has answered; requests that
    need it wait. Two threads must not import at once: of packages that import their modules, one of them
    would see a half-made one. What only jobs and looks at logs need begins when nobody asks.
    """

    def __init__(self, workspace: Workspace, cache: Path, live: Live | None, leaving: asyncio.Event) -> None:
        self.workspace = workspace
        self._live = live
        self._leaving = leaving
        self.jobs = Jobs(workspace.jobs)
        self._cache = cache
        self._loaded = {room: threading.Event() for room in ROOMS}

    async def load(self, quiet: Quiet) -> None:
        """Import the rooms after the first answer; begin what jobs come from when nobody asks."""
        await quiet.until_answered(QUIET_S)
        await run_in_threadpool(self._import_rooms)
        await quiet.until_quiet(QUIET_S)
        if sys.platform == "linux":
            self.jobs.warm = await run_in_threadpool(Warm)
        from flysid.studio.quick_look import begin_workers

        await run_in_threadpool(begin_workers)

    def _import_rooms(self) -> None:
        """One after the other; requests wait for theirs."""
        try:
            for room, loaded in self._loaded.items():
                importlib.import_module(f"flysid.studio.{room}")
                loaded.set()
        finally:  # a request must not wait for a room that never comes: it says itself what is wrong
            for loaded in self._loaded.values():
                loaded.set()

    @cached_property
    def flights(self) -> Flights:
        from flysid.studio.flights import Flights

        return Flights(self.workspace, self._cache)

    @cached_property
    def reviews(self) -> Reviews:
        from flysid.studio.reviews import Reviews

        return Reviews(self.workspace)

    @cached_property
    def spectra(self) -> Spectra:
        from flysid.studio.spectra import Spectra

        return Spectra(self.workspace)

    @cached_property
    def recipes(self) -> Recipes:
        from flysid.studio.channels import Recipes

        return Recipes(self.workspace.recipes)

    async def series(self, request: Request) -> Response:
        body = await run_in_threadpool(self.flights.series, forms.query_of(request, forms.Window))
        return Response(body, media_type="application/octet-stream")

    async def write_recipe(self, request: Request) -> Response:
        forms.query_of(request, forms.Nothing)
        draft = await forms.body_of(request, forms.Draft)
        return answer(self.recipes.write(request.path_params["name"], draft))

    async def judge_recipe(self, request: Request) -> Response:
        """A recipe as TOML and as a form, whichever of them was given; nothing is kept."""
        from flysid.studio.channels import judged

        return answer(judged(await forms.body_of(request, forms.Draft)))

    async def upload(self, request: Request) -> Response:
        """Keep a log; the job that takes it in."""
        from flysid.studio.uploads import keep_upload

        asked = forms.query_of(request, forms.Upload)
        length = int(request.headers["content-length"])
        path = await keep_upload(self.workspace.uploads, asked.name, request.stream(), length)
        job = self.jobs.add(*commands.ingest(self.workspace, path, asked))
        return answer({"job": job_facts(job), "upload": path.parent.name, "name": path.name}, 202)

    async def sample(self, request: Request) -> Response:
        """A simulated flight, for somebody who has no log at hand; the job that makes it."""
        forms.query_of(request, forms.Nothing)
        words, about, then = commands.sample(self.workspace)
        return answer({"job": job_facts(self.jobs.add(words, "read", about, then))}, 202)

    def _look_at_upload(self, where: Where, _asked: object) -> object:
        from flysid.studio.quick_look import quick_look
        from flysid.studio.uploads import find_upload

        return quick_look(find_upload(self.workspace.uploads, where["upload"]))

    async def job(self, request: Request) -> Response:
        forms.query_of(request, forms.Nothing)
        job_id = request.path_params["job"]
        if request.method == "DELETE":
            await run_in_threadpool(self.jobs.cancel, job_id)
        text = self.jobs.text(job_id, "out").decode("utf-8", "replace")
        return answer({**job_facts(self.jobs.get(job_id)), "out": text})

    async def job_events(self, request: Request) -> Response:
        """The job's log and states as server-sent events; `Last-Event-ID` resumes."""
        forms.query_of(request, forms.Nothing)
        job_id = request.path_params["job"]
        self.jobs.get(job_id)
        seen = request.headers.get("last-event-id", "0")
        after = int(seen) if seen.isdigit() and len(seen) < 12 else 0
        return StreamingResponse(self._events(job_id, after), media_type="text/event-stream")

    async def _events(self, job_id: str, after: int) -> AsyncIterator[str]:
        yield f"event: job\ndata: {json.dumps(job_facts(self.jobs.get(job_id)))}\n\n"
        lines = self.jobs.events(job_id, after)
        waiting = asyncio.ensure_future(anext(lines, None))
        leaving = asyncio.ensure_future(self._leaving.wait())
        try:
            while not leaving.done():
                await asyncio.wait([waiting, leaving], timeout=SILENCE_S, return_when=asyncio.FIRST_COMPLETED)
                if not waiting.done():
                    yield ": still at it\n\n"
                    continue
                line = waiting.result()
                if line is None:
                    break
                yield f"id: {line[0]}\nevent: line\ndata: {json.dumps(line[1])}\n\n"
                waiting = asyncio.ensure_future(anext(lines, None))
        finally:
            waiting.cancel()
            leaving.cancel()
        yield f"event: ended\ndata: {json.dumps(job_facts(self.jobs.get(job_id)))}\n\n"

    @property
    def live(self) -> Live:
        if self._live is None:
            raise NotThere("no link is open", hint="flysid studio --live udp:0.0.0.0:14550")
        return self._live

    async def live_events(self, request: Request) -> Response:
        """What the link brings, as server-sent events; `Last-Event-ID` resumes."""
        forms.query_of(request, forms.Nothing)
        seen = seen_by(request.headers.get("last-event-id", ""))
        return StreamingResponse(stream(self.live, seen, self._leaving), media_type="text/event-stream")

    def _about(self, _where: Where, _asked: object) -> object:
        data = str(self.workspace.data)
        folder = str(self.workspace.folder)
        return {"version": flysid.__version__, "data": data, "folder": folder, "live": self._live is not None}

    def _filters(self, where: Where, asked: forms.Filters) -> object:
        return self.spectra.filters(where["flight"], asked.more, asked.without)

    def _list_runs(self, _where: Where, _asked: object) -> object:
        from flysid.studio.run_views import list_runs

        return list_runs(self.workspace)

    def _describe_run(self, where: Where, _asked: object) -> object:
        from flysid.studio.run_views import describe_run

        return describe_run(self.workspace, where["run"])

    def _explain(self, where: Where, asked: forms.Explained) -> object:
        from flysid.studio.explain import explain

        return explain(self.workspace, where["run"], asked)

    def _find_worst(self, where: Where, _asked: object) -> object:
        from flysid.studio.explain import worst_seconds

        return worst_seconds(self.workspace, where["run"])

    def _align(self, _where: Where, asked: forms.Aligned) -> object:
        from flysid.studio.channels import align_channel

        return align_channel(self.workspace, self.recipes, asked)

    def _list_models(self, _where: Where, _asked: object) -> object:
        from flysid.studio.channels import listed_models

        return {"models": listed_models()}

    def _suggest(self, where: Where, _asked: object) -> object:
        """The suggestions for a flight where they are known, else the job that finds them."""
        self.flights.manifest(where["flight"])
        return commands.suggestions(self.jobs, self.workspace, where["flight"])

    def _run_page(self, where: Where) -> Path:
        from flysid.studio.run_views import page_of

        return page_of(self.workspace, where["run"])

    async def report_file(self, request: Request) -> Response:
        from flysid.studio.run_views import file_of

        forms.query_of(request, forms.Nothing)
        path = file_of(self.workspace, request.path_params["run"], request.path_params["name"])
        return FileResponse(path, filename=path.name)

    def _model(self, where: Where) -> bytes:
        from flysid.studio.run_views import model_of

        return model_of(self.workspace, where["run"], where["channel"], where["label"])

    def _route(self, method: str, path: str, room: str, handler: Handler) -> Route:
        """A route whose handler answers once the room that it needs has been imported; "": none."""

        async def waiting(request: Request) -> Response:
            if room and not self._loaded[room].is_set():
                await run_in_threadpool(self._loaded[room].wait)
            return await handler(request)

        return Route(f"/api/1/{path}", waiting, methods=[method])

    def _get(self, path: str, room: str, find: Look, form: type[Any] = forms.Nothing) -> Route:
        """What is found by the names in the address and by the query: in a thread, where it needs a room."""

        async def handler(request: Request) -> Response:
            asked = forms.query_of(request, form)
            where = request.path_params
            return answer(await run_in_threadpool(find, where, asked) if room else find(where, asked))

        return self._route("GET", path, room, handler)

    def _get_page(self, path: str, room: str, find: Callable[[Where], Path | bytes | str]) -> Route:
        """A page, picture or file of its own origin: its scripts run, and reach nothing of the studio."""

        async def handler(request: Request) -> Response:
            forms.query_of(request, forms.Nothing)
            found = await run_in_threadpool(find, request.path_params)
            headers = {"Content-Security-Policy": FRAME_POLICY}
            if isinstance(found, Path):
                return FileResponse(found, headers=headers)
            return Response(found, headers=headers, media_type=guess_type(path)[0] or "application/json")

        return self._route("GET", path, room, handler)

    def _post_job(
        self, path: str, room: str, form: type[Any], plan: Callable[[Any], commands.Planned]
    ) -> Route:
        """The job that `plan` makes of a body, or its commands alone for a preview."""

        async def handler(request: Request) -> Response:
            asked = await forms.body_of(request, form)
            words, about, then = plan(asked)
            if asked.preview:
                after = {"then": commands.shown(then)} if then else {}
                return answer({"command": commands.shown(words), **after})
            return answer(job_facts(self.jobs.add(words, "fit", about, then)), 202)

        return self._route("POST", path, room, handler)

    def routes(self) -> list[Route]:
        """All routes; reads are GET, what makes or changes something is POST, PUT or DELETE."""
        get = self._get
        page = self._get_page
        post = self._post_job
        route = self._route
        home = self.workspace
        return [
            get("flights", "flights", lambda _, q: self.flights.listing(q.q, q.most), forms.Listing),
            get("flights/{flight}", "flights", lambda at, _: self.flights.describe(at["flight"])),
            get("flights/{flight}/track", "flights", lambda at, _: self.flights.track(at["flight"])),
            get("flights/{flight}/suggestions", "flights", self._suggest),
            get("flights/{flight}/review", "reviews", lambda at, _: self.reviews.document(at["flight"])),
            page("flights/{flight}/review.html", "reviews", lambda at: self.reviews.page(at["flight"])),
            get("flights/{flight}/spectrum", "spectra", lambda at, _: self.spectra.spectrum(at["flight"])),
            page("flights/{flight}/spectrum.svg", "spectra", lambda at: self.spectra.picture(at["flight"])),
            get("flights/{flight}/filters", "spectra", self._filters, forms.Filters),
            route("GET", "series", "flights", self.series),
            get("align", "channels", self._align, forms.Aligned),
            get("models", "channels", self._list_models),
            get("recipes", "channels", lambda *_: {"recipes": self.recipes.listing()}),
            route("POST", "recipes", "channels", self.judge_recipe),
            get("recipes/{name}", "channels", lambda at, _: self.recipes.read(at["name"])),
            route("PUT", "recipes/{name}", "channels", self.write_recipe),
            route("POST", "uploads", "uploads", self.upload),
            route("POST", "samples", "uploads", self.sample),
            get("uploads/{upload}", "quick_look", self._look_at_upload),
            post("fits", "channels", forms.Fit, lambda q: commands.fit(home, self.recipes, q)),
            post("validates", "run_views", forms.Validate, lambda q: commands.validate(home, q)),
            post("compares", "run_views", forms.Compare, lambda q: commands.compare(home, q)),
            page(
                "comparisons/{name}/report.html",
                "run_views",
                lambda at: commands.comparison_page(home, at["name"]),
            ),
            get("runs", "run_views", self._list_runs),
            get("runs/{run}", "run_views", self._describe_run),
            get("runs/{run}/explanation", "explain", self._explain, forms.Explained),
            get("runs/{run}/worst", "explain", self._find_worst),
            route("GET", "runs/{run}/files/{name}", "run_views", self.report_file),
            page("runs/{run}/report.html", "run_views", self._run_page),
            page("runs/{run}/models/{channel:path}/{label}", "run_views", self._model),
            get("about", "", self._about),
            get("jobs", "", lambda *_: {"jobs": [job_facts(job) for job in self.jobs.listing()]}),
            route("GET", "jobs/{job}", "", self.job),
            route("DELETE", "jobs/{job}", "", self.job),
            route("GET", "jobs/{job}/events", "", self.job_events),
            get("live", "", lambda *_: self.live.describe()),
            route("GET", "live/events", "", self.live_events),
            *asset_routes(),
        ]


def make_app(
    workspace: Workspace,
    key: Key,
    cache: Path,
    leaving: asyncio.Event,
    bounds: RequestBounds | None = None,
    live: Live | None = None,
) -> RequestGuard:
    """The application, guarded.

    `workspace`: its folders.
    `key`: what a browser must show.
    `cache`: an empty folder for mapped fields.
    `leaving`: set when the server is to end: streams end then.
    `bounds`: of requests' bodies.
    `live`: what is recorded and watched meanwhile.
    """
    studio = Studio(workspace, cache, live, leaving)
    quiet = Quiet()

    @contextlib.asynccontextmanager
    async def working(_: Starlette) -> AsyncIterator[None]:
        tasks = [asyncio.create_task(studio.load(quiet)), asyncio.create_task(studio.jobs.work())]
        yield
        for task in tasks:
            task.cancel()
        if studio.jobs.warm is not None:
            studio.jobs.warm.close()

    app = Starlette(
        routes=studio.routes(),
        lifespan=working,
        exception_handlers={FlysidError: _refuse, HTTPException: _not_served, ClientDisconnect: _gone},
    )
    return RequestGuard(app, key, bounds or RequestBounds(), quiet)


def answer(content: object, status: int = 200) -> Response:
    """JSON; numbers that are not finite become null."""
    return Response(msgspec.json.encode(content), status, media_type="application/json")


def job_facts(job: Job) -> dict[str, Any]:
    """A job as the page shows it."""
    return {**msgspec.to_builtins(msgspec.structs.replace(job, seal="")), "command": job.command}


def asset_routes() -> list[Route]:
    """The page, and its assets at an address that changes with them: a browser keeps what it has."""
    package = Path(str(resources.files("flysid")))  # to ask for the report's own would import it, and so all
    own = package / "studio" / "assets"
    uplot = package / "validate" / "show" / "page" / "assets"
    found = {
        path.name: path for path in [*own.iterdir(), *(uplot / name for name in UPLOT)] if path.is_file()
    }
    digest = hashlib.sha256(b"".join(found[name].read_bytes() for name in sorted(found))).hexdigest()[:16]
    page = found["index.html"].read_text("utf-8").replace('="/', f'="/{digest}/').encode()

    async def index(_: Request) -> Response:
        return Response(page, media_type="text/html")

    async def asset(request: Request) -> Response:
        path = found.get(request.path_params["name"])
        if path is None:
            raise HTTPException(404)
        return FileResponse(path, headers={"Cache-Control": "private, max-age=31536000, immutable"})

    return [Route("/", index, methods=["GET"]), Route(f"/{digest}/{{name}}", asset, methods=["GET"])]


async def _refuse(_: Request, error: Exception) -> Response:
    assert isinstance(error, FlysidError)
    status = 404 if isinstance(error, NotThere) else 507 if isinstance(error, WriteError) else 400
    return answer({"message": error.message, "where": error.where, "hint": error.hint}, status)


async def _not_served(_: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    words = {404: "there is no such page", 405: "that cannot be done here"}
    return answer({"message": words.get(error.status_code, error.detail)}, error.status_code)


async def _gone(_: Request, __: Exception) -> Response:
    return answer({"message": "the request ended before its body did"}, 408)
