"""Requests made from the interface's own description: none of them is answered by a fault of the server."""

from collections import Counter

import hypothesis
import pytest
import schemathesis
from hypothesis import HealthCheck, Phase
from schemathesis.checks import not_a_server_error
from serving import ADMINISTRATOR, Served

from hardware.lab.app import make_app

# Requests for each operation, in the suite and with --long.
FEW, MANY = 3, 500
# What does not end by itself.
STREAMS = ("/api/events", "/api/pictures")


@pytest.mark.timeout(3600)
@pytest.mark.parametrize("examples", [FEW, pytest.param(MANY, marks=pytest.mark.long)])
def test_no_request_is_answered_by_a_fault(lasting: Served, examples: int):
    schema = schemathesis.openapi.from_dict(make_app(lasting.lab).openapi())
    some = hypothesis.settings(
        max_examples=examples,
        deadline=None,
        database=None,
        derandomize=True,
        phases=[Phase.explicit, Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    statuses = Counter()

    def ask(case: schemathesis.Case) -> None:
        # Some of the requests end tokens; and whoever operates is asked for more than somebody who is refused at once.
        client = lasting.program(ADMINISTRATOR)
        client.post("/api/lock", json={"take_over": True})
        case.headers = {**case.headers, "Authorization": client.headers["Authorization"]}
        answer = case.call(base_url=lasting.url, timeout=20)
        case.validate_response(answer, checks=[not_a_server_error])
        statuses[case.operation.label, answer.status_code] += 1
        client.close()

    operations = [found.ok() for found in schema.get_all_operations()]
    for operation in operations:
        if operation.path not in STREAMS:
            some(hypothesis.given(case=operation.as_strategy())(ask))()
    assert len({label for label, _ in statuses}) == len(operations) - len(STREAMS)
    assert 202 in {status for label, status in statuses if label == "POST /api/jobs"}
    assert all(status < 500 for _, status in statuses)
    print(f"{statuses.total()} requests of {len(operations) - len(STREAMS)} operations, none answered by a fault")
