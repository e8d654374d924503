import pytest

from bunraku.studio.server.safety import POLICY, Keys


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 200),
        ({"authorization": ""}, 401),
        ({"authorization": "Bearer other"}, 401),
        ({"authorization": "Basic secret"}, 401),
        ({"origin": "http://localhost:8734"}, 200),
        ({"origin": "http://evil.example"}, 403),
        ({"origin": "http://localhost:1"}, 403),
        ({"origin": "null"}, 403),
        ({"host": "evil.example:8734"}, 403),
        ({"host": "127.0.0.1:8734"}, 200),
        ({"host": "localhost.evil.example"}, 403),
        ({"sec-fetch-site": "cross-site"}, 403),
        ({"sec-fetch-site": "same-origin"}, 200),
    ],
)
def test_who_is_let_in(client, headers, status):
    answer = client.get("/api/jobs", headers=headers)
    assert answer.status_code == status
    if status != 200:
        assert set(answer.json()) == {"error", "kind"} and answer.json()["error"][-1] != "."


def test_a_token_of_other_letters_is_no_fault(client):
    answer = client.get("/api/jobs", headers={"authorization": "Bearer s\u00e9cret".encode("latin-1")})
    assert answer.status_code == 401


def test_the_page_needs_no_token_and_may_load_nothing_from_elsewhere(client):
    page = client.get("/", headers={"authorization": ""})
    assert page.status_code == 200 and "<script" in page.text
    policy = page.headers["content-security-policy"]
    assert policy == POLICY and "http" not in policy and "unsafe" not in policy and "*" not in policy
    assert page.headers["x-content-type-options"] == "nosniff" and page.headers["referrer-policy"] == "no-referrer"
    assert "http://" not in page.text and "https://" not in page.text


def test_files_outside_of_the_page_are_not_served(client):
    for path in ("/../app.py", "/%2e%2e/app.py", "/..%2fapp.py", "/static/../../errors.py"):
        assert client.get(path).status_code in (403, 404)


def test_a_password_gives_the_token_and_a_wrong_one_does_not(client):
    client.app.state.keys.__dict__["password"] = "long enough"
    headers = {"authorization": ""}
    wrong = client.post("/api/login", json={"password": "guess"}, headers=headers)
    assert wrong.status_code == 401
    right = client.post("/api/login", json={"password": "long enough"}, headers=headers)
    assert right.json() == {"token": "secret"}


def test_without_a_password_nobody_logs_in(client):
    assert client.post("/api/login", json={"password": ""}).status_code == 401


def test_tokens_are_long_and_not_alike():
    assert len({Keys().token for _ in range(100)}) == 100 and len(Keys().token) >= 32
