"""A client of the Foxglove WebSocket protocol, by its published specification alone."""

from __future__ import annotations

import asyncio
import itertools
import struct
from collections.abc import Callable
from typing import Any

import aiohttp

from support.simulation import what_runs

PROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
_MESSAGE, _TIME, _RESPONSE = 1, 2, 3
"""First bytes of the server's binary messages."""
_CLIENT_MESSAGE, _CLIENT_CALL = 1, 2


class FoxgloveClient:
    """One connection; ``async with FoxgloveClient(url) as client``."""

    def __init__(self, url: str, **options: Any) -> None:
        self._url, self._options = url, options
        self.info: dict[str, Any] = {}
        self.channels: dict[str, dict[str, Any]] = {}
        self.services: dict[str, dict[str, Any]] = {}
        self.messages: dict[str, list[tuple[int, bytes]]] = {}
        """Topic -> (time in nanoseconds, CDR) of each message that arrived."""
        self.times: list[int] = []
        self.answers: dict[str, dict[str, Any]] = {}
        """Identifier of a request -> values of parameters."""
        self.updates: list[dict[str, Any]] = []
        self.warnings: list[str] = []
        self.failures: list[str] = []
        self._responses: dict[int, bytes] = {}
        self._topics: dict[int, str] = {}
        self._subscribed: dict[str, int] = {}
        """Topic with a subscription -> its channel."""
        self._ids = itertools.count(1)

    async def __aenter__(self) -> FoxgloveClient:
        self._session = aiohttp.ClientSession()
        self.socket = await self._session.ws_connect(self._url, protocols=PROTOCOLS, max_msg_size=0, **self._options)
        await self.until(lambda: bool(self.info), "a greeting")
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.socket.close()
        await self._session.close()

    async def until(self, condition: Callable[[], bool], what: str, send: Callable[[], Any] | None = None) -> None:
        """Receives until a condition holds; ``send`` is awaited ten times a second meanwhile."""
        loop = asyncio.get_running_loop()
        end, next_s = loop.time() + 120.0, 0.0
        while not condition():
            assert loop.time() < end, f"still no {what}{what_runs()}"
            if send is not None and loop.time() >= next_s:
                next_s = loop.time() + 0.1
                await send()
            try:
                message = await self.socket.receive(timeout=0.1)
            except asyncio.TimeoutError:
                continue
            assert message.type in (aiohttp.WSMsgType.TEXT, aiohttp.WSMsgType.BINARY), f"{message.type}, and still no {what}"
            if message.type is aiohttp.WSMsgType.TEXT:
                self._on_json(message.json())
                await self._renew()
            else:
                self._on_binary(message.data)

    def _on_json(self, value: dict[str, Any]) -> None:
        if value["op"] == "serverInfo":
            self.info = value
        elif value["op"] == "advertise":
            self.channels.update({channel["topic"]: channel for channel in value["channels"]})
        elif value["op"] == "unadvertise":
            self.channels = {name: c for name, c in self.channels.items() if c["id"] not in value["channelIds"]}
        elif value["op"] == "advertiseServices":
            self.services.update({service["name"]: service for service in value["services"]})
        elif value["op"] == "parameterValues":
            values = {p["name"]: p.get("value") for p in value["parameters"]}
            if "id" in value:
                self.answers[value["id"]] = values
            else:
                self.updates.append(values)
        elif value["op"] == "serviceCallFailure":
            self.failures.append(value["message"])
        elif value["op"] == "status":
            self.warnings.append(value["message"])

    def _on_binary(self, data: bytes) -> None:
        if data[0] == _MESSAGE:
            number, time_ns = struct.unpack_from("<IQ", data, 1)
            self.messages.setdefault(self._topics[number], []).append((time_ns, data[13:]))
        elif data[0] == _TIME:
            self.times.append(struct.unpack_from("<Q", data, 1)[0])
        elif data[0] == _RESPONSE:
            _, call, length = struct.unpack_from("<III", data, 1)
            self._responses[call] = data[13 + length :]

    async def subscribe(self, *topics: str) -> None:
        await self.until(lambda: set(topics) <= set(self.channels), f"channels of {topics}")
        self._subscribed.update(dict.fromkeys(topics, -1))
        await self._renew()

    async def _renew(self) -> None:
        """Subscribes to the channels of the wanted topics, as the app does: to the new one of a topic that was gone for a while, too.

        On a machine that stalls for the 20 s of DDS's lease, all topics of a node are gone until it is discovered again.
        """
        wanted = []
        for topic, channel in self._subscribed.items():
            present = self.channels.get(topic, {}).get("id", channel)
            if present != channel:
                number = next(self._ids)
                self._topics[number], self._subscribed[topic] = topic, present
                wanted.append({"id": number, "channelId": present})
        if wanted:
            await self.socket.send_json({"op": "subscribe", "subscriptions": wanted})

    async def unsubscribe(self, topic: str) -> None:
        del self._subscribed[topic]
        number = max(number for number, name in self._topics.items() if name == topic)
        await self.socket.send_json({"op": "unsubscribe", "subscriptionIds": [number]})

    async def advertise(self, topic: str, type_name: str, encoding: str = "cdr") -> int:
        number = next(self._ids)
        channel = {"id": number, "topic": topic, "encoding": encoding, "schemaName": type_name}
        await self.socket.send_json({"op": "advertise", "channels": [channel]})
        return number

    async def publish(self, number: int, data: bytes) -> None:
        await self.socket.send_bytes(struct.pack("<BI", _CLIENT_MESSAGE, number) + data)

    async def call(self, service: str, request: bytes) -> bytes | None:
        """Returns the response of a service; None if it failed, which ``failures`` explains."""
        await self.until(lambda: service in self.services, f"service {service}")
        number, before = next(self._ids), len(self.failures)
        head = struct.pack("<BIII", _CLIENT_CALL, self.services[service]["id"], number, 3)
        await self.socket.send_bytes(head + b"cdr" + request)
        await self.until(lambda: number in self._responses or len(self.failures) > before, f"response of {service}")
        return self._responses.get(number)

    async def get_parameters(self, *names: str) -> dict[str, Any]:
        return await self._parameters({"op": "getParameters", "parameterNames": list(names)})

    async def set_parameters(self, values: dict[str, Any]) -> dict[str, Any]:
        """Sets parameters, and returns the values that they have afterwards."""
        return await self._parameters({"op": "setParameters", "parameters": [{"name": n, "value": v} for n, v in values.items()]})

    async def _parameters(self, request: dict[str, Any]) -> dict[str, Any]:
        identifier = f"request-{next(self._ids)}"
        await self.socket.send_json({**request, "id": identifier})
        await self.until(lambda: identifier in self.answers, request["op"])
        return self.answers[identifier]
