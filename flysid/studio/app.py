"""The studio's HTTP interface: routes, what they take, and errors in flysid's own words."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import importlib
import json
import sys
import threading
from collections.abc import AsyncIterator, Awaitable, Callable
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, Response, StreamingResponse
from starlette.routing import Route

import flysid
from flysid.errors import FlysidError, UsageError, WriteError
from flysid.foreign import inner_path
from flysid.studio import commands, forms
from flysid.studio.folders import NotThere, Workspace, is_name
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
Form = TypeVar("Form")


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

    async def about(self, request: Request) -> Response:
        query_of(request, forms.Nothing)
        data = str(self.workspace.data)
        folder = str(self.workspace.folder)
        return answer(
            {"version": flysid.__version__, "data": data, "folder": folder, "live": self._live is not None}
        )

    async def list_flights(self, request: Request) -> Response:
        asked = query_of(request, forms.Listing)
        return answer(await run_in_threadpool(self.flights.listing, asked.q, asked.most))

    async def describe_flight(self, request: Request) -> Response:
        query_of(request, forms.Nothing)
        return answer(await run_in_threadpool(self.flights.describe, request.path_params["flight"]))

    async def track(self, request: Request) -> Response:
        query_of(request, forms.Nothing)
        return answer(await run_in_threadpool(self.flights.track, request.path_params["flight"]))

    async def review(self, request: Request) -> Response:
        query_of(request, forms.Nothing)
        return answer(await run_in_threadpool(self.reviews.document, request.path_params["flight"]))

    async def review_page(self, request: Request) -> Response:
        query_of(request, forms.Nothing)
        page = await run_in_threadpool(self.reviews.page, request.path_params["flight"])
        return Response(page, media_type="text/html", headers={"Content-Security-Policy": FRAME_POLICY})

    async def spectrum(self, request: Request) -> Response:
        query_of(request, forms.Nothing)
        return answer(await run_in_threadpool(self.spectra.spectrum, request.path_params["flight"]))

    async def spectrum_picture(self, request: Request) -> Response:
        query_of(request, forms.Nothing)
        drawn = await run_in_threadpool(self.spectra.picture, request.path_params["flight"])
        return Response(drawn, media_type="image/svg+xml", headers={"Content-Security-Policy": FRAME_POLICY})

    async def filters(self, request: Request) -> Response:
        asked = query_of(request, forms.Filters)
        flight = request.path_params["flight"]
        return answer(await run_in_threadpool(self.spectra.filters, flight, asked.more, asked.without))

    async def series(self, request: Request) -> Response:
        body = await run_in_threadpool(self.flights.series, query_of(request, forms.Window))
        return Response(body, media_type="application/octet-stream")

    async def suggest(self, request: Request) -> Response:
        """The suggestions for a flight where they are known, else the job that finds them."""
        query_of(request, forms.Nothing)
        flight = request.path_params["flight"]
        await run_in_threadpool(self.flights.manifest, flight)
        return answer(await run_in_threadpool(commands.suggestions, self.jobs, self.workspace, flight))

    async def align(self, request: Request) -> Response:
        from flysid.studio.channels import align_channel

        asked = query_of(request, forms.Aligned)
        return answer(await run_in_threadpool(align_channel, self.workspace, self.recipes, asked))

    async def list_recipes(self, request: Request) -> Response:
        query_of(request, forms.Nothing)
        return answer({"recipes": await run_in_threadpool(self.recipes.listing)})

    async def list_models(self, request: Request) -> Response:
        query_of(request, forms.Nothing)
        from flysid.studio.channels import listed_models

        return answer({"models": listed_models()})

    async def recipe(self, request: Request) -> Response:
        query_of(request, forms.Nothing)
        name = request.path_params["name"]
        if request.method == "PUT":
            return answer(self.recipes.write(name, await body_of(request, forms.Draft)))
        return answer(self.recipes.read(name))

    async def judge_recipe(self, request: Request) -> Response:
        """A recipe as TOML and as a form, whichever of them was given; nothing is kept."""
        from flysid.studio.channels import judged

        return answer(judged(await body_of(request, forms.Draft)))

    async def upload(self, request: Request) -> Response:
        """Keep a log; the job that takes it in."""
        from flysid.studio.uploads import keep_upload

        asked = query_of(request, forms.Upload)
        length = int(request.headers["content-length"])
        path = await keep_upload(self.workspace.uploads, asked.name, request.stream(), length)
        job = self.jobs.add(*commands.ingest(self.workspace, path, asked))
        return answer({"job": told(job), "upload": path.parent.name, "name": path.name}, 202)

    async def sample(self, request: Request) -> Response:
        """A simulated flight, for somebody who has no log at hand; the job that makes it."""
        query_of(request, forms.Nothing)
        words, about, then = commands.sample(self.workspace)
        return answer({"job": told(self.jobs.add(words, "read", about, then))}, 202)

    async def quick_look(self, request: Request) -> Response:
        from flysid.studio.quick_look import quick_look

        query_of(request, forms.Nothing)
        name = request.path_params["upload"]
        found = list((self.workspace.uploads / name).glob("*")) if is_name(name) else []
        found = [path for path in found if not path.name.startswith(".")]
        if not found:
            raise NotThere(f"no upload {name!r}")
        log = inner_path(self.workspace.uploads, f"{name}/{found[0].name}", self.workspace.uploads)
        return answer(await run_in_threadpool(quick_look, log))

    async def fit(self, request: Request) -> Response:
        asked = await body_of(request, forms.Fit)
        words, run, then = commands.fit(self.workspace, self.recipes, asked)
        if asked.preview:
            return answer({"command": commands.shown(words), "then": commands.shown(then)})
        return answer(told(self.jobs.add(words, "fit", {"run": str(run)}, then)), 202)

    async def validate(self, request: Request) -> Response:
        asked = await body_of(request, forms.Validate)
        words, run = commands.validate(self.workspace, asked)
        if asked.preview:
            return answer({"command": commands.shown(words)})
        return answer(told(self.jobs.add(words, "fit", {"run": str(run)})), 202)

    async def compare(self, request: Request) -> Response:
        asked = await body_of(request, forms.Compare)
        words, out = commands.compare(self.workspace, asked)
        if asked.preview:
            return answer({"command": commands.shown(words)})
        return answer(told(self.jobs.add(words, "fit", {"comparison": out.name})), 202)

    async def comparison_page(self, request: Request) -> Response:
        query_of(request, forms.Nothing)
        return _page(commands.comparison_page(self.workspace, request.path_params["name"]))

    async def list_jobs(self, request: Request) -> Response:
        query_of(request, forms.Nothing)
        return answer({"jobs": [told(job) for job in self.jobs.listing()]})

    async def job(self, request: Request) -> Response:
        query_of(request, forms.Nothing)
        job_id = request.path_params["job"]
        if request.method == "DELETE":
            await run_in_threadpool(self.jobs.cancel, job_id)
        text = self.jobs.text(job_id, "out").decode("utf-8", "replace")
        return answer({**told(self.jobs.get(job_id)), "out": text})

    async def job_events(self, request: Request) -> Response:
        """The job's log and states as server-sent events; `Last-Event-ID` resumes."""
        query_of(request, forms.Nothing)
        job_id = request.path_params["job"]
        self.jobs.get(job_id)
        seen = request.headers.get("last-event-id", "0")
        after = int(seen) if seen.isdigit() and len(seen) < 12 else 0
        return StreamingResponse(self._events(job_id, after), media_type="text/event-stream")

    async def _events(self, job_id: str, after: int) -> AsyncIterator[str]:
        yield f"event: job\ndata: {json.dumps(told(self.jobs.get(job_id)))}\n\n"
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
        yield f"event: ended\ndata: {json.dumps(told(self.jobs.get(job_id)))}\n\n"

    @property
    def live(self) -> Live:
        if self._live is None:
            raise NotThere("no link is open", hint="flysid studio --live udp:0.0.0.0:14550")
        return self._live

    async def describe_live(self, request: Request) -> Response:
        query_of(request, forms.Nothing)
        return answer(self.live.describe())

    async def live_events(self, request: Request) -> Response:
        """What the link brings, as server-sent events; `Last-Event-ID` resumes."""
        query_of(request, forms.Nothing)
        seen = seen_by(request.headers.get("last-event-id", ""))
        return StreamingResponse(stream(self.live, seen, self._leaving), media_type="text/event-stream")

    async def list_runs(self, request: Request) -> Response:
        from flysid.studio.run_views import list_runs

        query_of(request, forms.Nothing)
        return answer(await run_in_threadpool(list_runs, self.workspace))

    async def describe_run(self, request: Request) -> Response:
        from flysid.studio.run_views import describe_run

        query_of(request, forms.Nothing)
        return answer(await run_in_threadpool(describe_run, self.workspace, request.path_params["run"]))

    async def explanation(self, request: Request) -> Response:
        from flysid.studio.explain import explain

        asked = query_of(request, forms.Explained)
        run = request.path_params["run"]
        return answer(await run_in_threadpool(explain, self.workspace, run, asked))

    async def run_page(self, request: Request) -> Response:
        from flysid.studio.run_views import page_of

        query_of(request, forms.Nothing)
        return _page(page_of(self.workspace, request.path_params["run"]))

    async def worst(self, request: Request) -> Response:
        from flysid.studio.explain import worst_seconds

        query_of(request, forms.Nothing)
        return answer(await run_in_threadpool(worst_seconds, self.workspace, request.path_params["run"]))

    async def report_file(self, request: Request) -> Response:
        from flysid.studio.run_views import file_of

        query_of(request, forms.Nothing)
        path = file_of(self.workspace, request.path_params["run"], request.path_params["name"])
        return FileResponse(path, filename=path.name)

    async def model(self, request: Request) -> Response:
        from flysid.studio.run_views import model_of

        query_of(request, forms.Nothing)
        where = request.path_params
        body = model_of(self.workspace, where["run"], where["channel"], where["label"])
        return Response(body, media_type="application/json")

    def _after_loading(self, room: str, handler: Handler) -> Handler:
        """The handler, when the room that it needs has been imported."""
        loaded = self._loaded[room]

        async def waiting(request: Request) -> Response:
            if not loaded.is_set():
                await run_in_threadpool(loaded.wait)
            return await handler(request)

        return waiting

    def routes(self) -> list[Route]:
        """All routes; reads are GET, what makes or changes something is POST, PUT or DELETE."""
        table = [
            ("GET", "flights", "flights", self.list_flights),
            ("GET", "flights/{flight}", "flights", self.describe_flight),
            ("GET", "flights/{flight}/track", "flights", self.track),
            ("GET", "flights/{flight}/suggestions", "flights", self.suggest),
            ("GET", "flights/{flight}/review", "reviews", self.review),
            ("GET", "flights/{flight}/review.html", "reviews", self.review_page),
            ("GET", "flights/{flight}/spectrum", "spectra", self.spectrum),
            ("GET", "flights/{flight}/spectrum.svg", "spectra", self.spectrum_picture),
            ("GET", "flights/{flight}/filters", "spectra", self.filters),
            ("GET", "series", "flights", self.series),
            ("GET", "align", "channels", self.align),
            ("GET", "models", "channels", self.list_models),
            ("GET", "recipes", "channels", self.list_recipes),
            ("POST", "recipes", "channels", self.judge_recipe),
            ("GET", "recipes/{name}", "channels", self.recipe),
            ("PUT", "recipes/{name}", "channels", self.recipe),
            ("POST", "uploads", "uploads", self.upload),
            ("POST", "samples", "uploads", self.sample),
            ("GET", "uploads/{upload}", "quick_look", self.quick_look),
            ("POST", "fits", "channels", self.fit),
            ("POST", "validates", "run_views", self.validate),
            ("POST", "compares", "run_views", self.compare),
            ("GET", "comparisons/{name}/report.html", "run_views", self.comparison_page),
            ("GET", "runs", "run_views", self.list_runs),
            ("GET", "runs/{run}", "run_views", self.describe_run),
            ("GET", "runs/{run}/explanation", "explain", self.explanation),
            ("GET", "runs/{run}/worst", "explain", self.worst),
            ("GET", "runs/{run}/files/{name}", "run_views", self.report_file),
            ("GET", "runs/{run}/report.html", "run_views", self.run_page),
            ("GET", "runs/{run}/models/{channel:path}/{label}", "run_views", self.model),
        ]
        return [
            *(
                Route(f"/api/1/{path}", self._after_loading(room, handler), methods=[method])
                for method, path, room, handler in table
            ),
            Route("/api/1/about", self.about, methods=["GET"]),
            Route("/api/1/jobs", self.list_jobs, methods=["GET"]),
            Route("/api/1/jobs/{job}", self.job, methods=["GET", "DELETE"]),
            Route("/api/1/jobs/{job}/events", self.job_events, methods=["GET"]),
            Route("/api/1/live", self.describe_live, methods=["GET"]),
            Route("/api/1/live/events", self.live_events, methods=["GET"]),
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

    Parameters
    ----------
    workspace : its folders.
    key : what a browser must show.
    cache : an empty folder for mapped fields.
    leaving : set when the server is to end: streams end then.
    bounds : of requests' bodies.
    live : what is recorded and watched meanwhile.
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


def query_of(request: Request, form: type[Form]) -> Form:
    """The query as a form; raises UsageError that names what is wrong. Repeated names become tuples."""
    known = {f.name: f for f in msgspec.structs.fields(form)}  # type: ignore[arg-type]
    values: dict[str, Any] = {}
    for name in request.query_params:
        given = request.query_params.getlist(name)
        is_many = name in known and isinstance(known[name].default, tuple)
        if len(given) > 1 and not is_many:
            raise UsageError(f"{name} is given {len(given)} times")
        values[name] = tuple(given) if is_many else given[0]
    return _convert(lambda: msgspec.convert(values, form, strict=False))


async def body_of(request: Request, form: type[Form]) -> Form:
    """The body, JSON, as a form; raises UsageError that names what is wrong."""
    body = await request.body()
    return _convert(lambda: msgspec.json.decode(body, type=form))


def _convert(convert: Callable[[], Form]) -> Form:
    try:
        return convert()
    except (msgspec.ValidationError, msgspec.DecodeError, RecursionError) as error:
        raise UsageError(f"not understood: {error}") from error


def answer(content: object, status: int = 200) -> Response:
    """JSON; numbers that are not finite become null."""
    return Response(msgspec.json.encode(content), status, media_type="application/json")


def told(job: Job) -> dict[str, Any]:
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


def _page(path: Path) -> Response:
    """A report in a frame of its own origin: its scripts run, and reach nothing of the studio."""
    return FileResponse(path, headers={"Content-Security-Policy": FRAME_POLICY})


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
