import pytest

pytest.importorskip("starlette", reason="the studio needs starlette; install it with: pip install 'bunraku[studio]'")
pytest.importorskip("uvicorn", reason="the studio needs uvicorn; install it with: pip install 'bunraku[studio]'")

from studio_process import Studio


@pytest.fixture(scope="session")
def studio(tmp_path_factory):
    """A studio that several tests share, with its sample."""
    one = Studio(tmp_path_factory.mktemp("studio") / "folder")
    yield one
    one.stop()


@pytest.fixture
def own_studio(tmp_path):
    """Start studios that end with the test."""
    started = []

    def start(*words, folder=None, **options):
        started.append(Studio(folder or tmp_path / "folder", *words, **options))
        return started[-1]

    yield start
    for one in started:
        one.stop()


@pytest.fixture
def app_client(tmp_path):
    """The application without its worker, on the same folder at each call."""
    pytest.importorskip("httpx2", reason="Starlette's test client needs httpx2")
    from starlette.testclient import TestClient

    from bunraku.studio.server.app import Keys, studio_app

    def start():
        app = studio_app(tmp_path / "folder", Keys(token="secret"), warm=False)
        return TestClient(app, base_url="http://localhost:8734", headers={"authorization": "Bearer secret"})

    return start


@pytest.fixture
def client(app_client):
    """The application without its worker: what is queued stays queued."""
    with app_client() as found:
        yield found


@pytest.fixture
def ready(client):
    """A character that is open, by its record alone."""
    state = client.app.state.studio
    record = state.store.new(
        "characters",
        {"name": "one", "file": "source/one.glb", "state": "ready", "error": "", "version": 1,
         "settings": {"up": "auto", "front": "auto", "unit": "auto", "handles": "predict"}},
    )  # fmt: skip
    return record["id"]
