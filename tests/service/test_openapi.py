"""Every route says what it does, what it takes and what it answers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import httpx
import pytest

from tests.service.support import Json, Server


@pytest.fixture(scope="module")
def document(server: Server) -> Json:
    found: Json = httpx.get(f"{server.url}/openapi.json").json()
    return found


def operations(document: Json) -> Iterator[tuple[str, Json]]:
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            yield f"{method.upper()} {path}", operation


def has_example(document: Json, content: Json) -> bool:
    if "example" in content or "examples" in content:
        return True
    schema = content.get("schema", {})
    for part in [schema, *schema.get("oneOf", ())]:
        target = part
        if "$ref" in part:
            target = document["components"]["schemas"][part["$ref"].rsplit("/", 1)[-1]]
        if "example" in target or "examples" in target:
            return True
    return False


def test_every_route_has_a_summary_and_a_description(document: Json) -> None:
    for name, operation in operations(document):
        assert operation.get("summary"), name
        assert operation.get("description"), name
        assert operation.get("tags"), name


def test_every_parameter_is_described(document: Json) -> None:
    for name, operation in operations(document):
        for parameter in operation.get("parameters", ()):
            described = parameter.get("description") or parameter["schema"].get("description")
            assert described, f"{name}: {parameter['name']}"


def test_every_body_and_answer_has_an_example(document: Json) -> None:
    for name, operation in operations(document):
        for type_, content in operation.get("requestBody", {}).get("content", {}).items():
            assert has_example(document, content), f"{name}: {type_}"
        answers = {status: a for status, a in operation["responses"].items() if int(status) < 300}
        assert answers, name
        for status, answer in answers.items():
            assert status == "204" or answer.get("content"), f"{name}: {status}"
            for type_, content in answer.get("content", {}).items():
                assert has_example(document, content), f"{name}: {status} {type_}"


def test_every_fault_is_a_problem(document: Json) -> None:
    for name, operation in operations(document):
        if name.split()[1] in ("/healthz", "/metrics"):
            continue
        faults = {status: a for status, a in operation["responses"].items() if int(status) >= 400}
        assert faults, name
        for status, answer in faults.items():
            assert set(answer["content"]) == {"application/problem+json"}, f"{name}: {status}"


def test_every_reference_leads_somewhere(document: Json) -> None:
    def references(node: Any) -> Iterator[str]:
        if isinstance(node, dict):
            if isinstance(node.get("$ref"), str):
                yield node["$ref"]
            for child in node.values():
                yield from references(child)
        elif isinstance(node, list):
            for child in node:
                yield from references(child)

    for reference in references(document):
        name = reference.removeprefix("#/components/schemas/")
        assert name in document["components"]["schemas"], reference


def test_the_documentation_is_served(server: Server) -> None:
    assert httpx.get(f"{server.url}/docs").status_code == 200
