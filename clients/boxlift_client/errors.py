"""What can go wrong between a client and a service, as a tree.

BoxliftError
├── ServiceError                    base of all below; `url` is where
│   ├── ServiceUnreachableError     nobody answers, or not in time
│   ├── ServiceProblemError         the service answered with a problem (RFC 9457)
│   │   ├── RequestRefusedError     4xx: what was sent is at fault; field, problem and remedy say how
│   │   │   └── NotAuthorizedError  401: no API key, or one that the service does not know
│   │   ├── ServiceBusyError        429: the service, or the key, has as much to do as it may; ask later
│   │   └── ServiceFailedError      5xx: the service is at fault, or cannot do this (yet)
│   └── UnexpectedAnswerError       the answer is not one of boxlift's
├── ServiceStartError               a service that was started here does not come up
├── WorkersCannotStartError         the processes of the local engine end before their first frame
└── RunStoppedError                 a run over a data set that no further frame would fare better in
"""

from __future__ import annotations

from dataclasses import dataclass

from boxlift.errors import BoxliftError


class ServiceError(BoxliftError):
    """Base of every error of talking to a service."""

    def __init__(self, url: str, message: str) -> None:
        self.url = url
        self.message = message
        super().__init__(url, message)

    def __str__(self) -> str:
        return f"{self.url}: {self.message}"


class ServiceUnreachableError(ServiceError):
    """Nobody answers at the URL, or not in time."""


class UnexpectedAnswerError(ServiceError):
    """The answer is not one of boxlift's: another program listens there, or another version."""


@dataclass(frozen=True)
class Problem:
    """The members of an RFC 9457 problem document; empty where the service sent none."""

    status: int
    type: str = "about:blank"
    title: str = ""
    detail: str = ""
    field: str | None = None
    problem: str | None = None
    remedy: str | None = None


class ServiceProblemError(ServiceError):
    """The service answered with a problem; `problem` holds its members."""

    def __init__(self, url: str, problem: Problem) -> None:
        self.problem = problem
        what = problem.detail or problem.title or "no reason given."
        where = f"{problem.field}: " if problem.field else ""
        super().__init__(url, f"{where}{what} (status {problem.status})")
        self.args = (url, problem)


class RequestRefusedError(ServiceProblemError):
    """4xx: the service refuses what was sent."""


class NotAuthorizedError(RequestRefusedError):
    """401: the service asks for an API key, and got none or one that it does not know."""


class ServiceBusyError(ServiceProblemError):
    """429: the service has as much to do as it takes on, or the key has used up its rate."""


class ServiceFailedError(ServiceProblemError):
    """5xx: the service failed, or cannot do what was asked."""


class ServiceStartError(BoxliftError):
    """The service that was started here does not come up; the message ends with its log."""


class WorkersCannotStartError(BoxliftError):
    """The worker processes of the local engine end before their first frame."""


class RunStoppedError(BoxliftError):
    """A run stopped before its last frame, for a reason that every frame would meet; it can be resumed."""
