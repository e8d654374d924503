"""A line of HTTP that is closed where its client does not end what it began to say."""

from __future__ import annotations

import asyncio

from uvicorn.protocols.http.h11_impl import H11Protocol


class Line(H11Protocol):
    """uvicorn's protocol, which itself waits for good for the first request and for the rest of a body."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._heard = self.loop.time()
        self._look()

    def data_received(self, data: bytes) -> None:
        body = self.cycle is not None and not self.cycle.response_complete
        super().data_received(data)
        if body:  # the head of a request has to come within the time as a whole
            self._heard = self.loop.time()

    def on_response_complete(self) -> None:
        self._heard = self.loop.time()
        super().on_response_complete()

    def _look(self) -> None:
        if self.transport.is_closing():
            return
        cycle, patience = self.cycle, self.timeout_keep_alive
        answering = cycle is not None and not (cycle.response_complete or cycle.more_body)
        if answering or self.flow.read_paused:
            self._heard = self.loop.time()
        elif self.loop.time() - self._heard > patience:
            self.transport.abort()
            return
        self.loop.call_later(patience / 4, self._look)
