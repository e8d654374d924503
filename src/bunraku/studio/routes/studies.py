"""The blind study: what a participant sees next, and the answers."""

from __future__ import annotations

ROUTES: list = []
