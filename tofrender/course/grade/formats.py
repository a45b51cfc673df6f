"""Formats of a results file (`grade --format`), which are converted from Gradescope's format.

Other platforms show all tests to students. Therefore the reason is left out for tests that
students must not see.
"""

import datetime
import json
import os
from collections.abc import Iterator, Mapping
from typing import Any
from xml.etree import ElementTree

Content = Mapping[str, Any]
RUN_VARIABLES = {
    "classroom": "CLASSROOM",
    "assignment": "ASSIGNMENT",
    "submission": "SUBMISSION_TAG",
    "commit": "COMMIT_URL",
    "release": "RELEASE_URL",
    "review": "REVIEW_URL",
}
"""Fields of Classroom 50's result, and the environment variables with their values."""
POINT = 100  # value of a point in Classroom 50, where scores are integers


def gradescope(content: Content) -> str:
    """Return Gradescope's `results.json`."""
    return _json(content)


def prairielearn(content: Content) -> str:
    """Return PrairieLearn's `results.json`. The score is a fraction of at most 1."""
    if not content["extra_data"]["complete"]:
        return _json({"gradable": False, "format_errors": [content["output"]]})
    tests = [
        {"name": test["name"], "message": reason}
        | {"points": test["score"], "max_points": test["max_score"]}
        for test, reason in _tests(content)
    ]
    extra = content["extra_data"]
    score = min(1.0, content["score"] / (extra["max_score"] or 1.0))
    output = content["output"]
    return _json({"gradable": True, "score": score, "output": output, "tests": tests})


def classroom50(content: Content) -> str:
    """Return Classroom 50's `result.json`, with scores in hundredths of a point.

    Bonus problems are left out. If the submission is not graded, the text is empty, which
    Classroom 50 does not accept as a result.
    """
    if not content["extra_data"]["complete"]:
        return ""

    # Tests; those of bonus problems have a maximum of 0
    tests = [
        {
            "test-name": test["name"],
            "passed": test["status"] == "passed",
            "score": round(POINT * test["score"]),
            "max-score": round(POINT * test["max_score"]),
        }
        for test, _ in _tests(content)
        if test["max_score"]
    ]

    # Description of the run
    run = {name: os.environ.get(variable, "") for name, variable in RUN_VARIABLES.items()}
    run["review"] = run["review"] or run["commit"]
    now = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    head: dict[str, Any] = {"schema": "classroom50/result/v1", **run, "datetime": now}
    head["usernames"] = [os.environ.get("USERNAME", "")]
    sums = {name: sum(test[name] for test in tests) for name in ("score", "max-score")}
    return _json(head | sums | {"tests": tests})


def junit(content: Content) -> str:
    """Return JUnit's XML, with a test case for each test and the points as properties."""
    # Without results, the only test case is an error
    extra = content["extra_data"]
    suite = ElementTree.Element("testsuite", name=extra["assignment"])
    if not extra["complete"]:
        case = ElementTree.SubElement(suite, "testcase", name="grading")
        ElementTree.SubElement(case, "error", message=content["output"])
        suite.attrib |= {"tests": "1", "errors": "1"}

    # Test cases
    for test, reason in _tests(content):
        problem, _, name = test["name"].partition(": ")
        seconds = f"{test['extra_data']['execution_time']:g}"
        case = ElementTree.SubElement(suite, "testcase", classname=problem, name=name, time=seconds)
        properties = ElementTree.SubElement(case, "properties")
        for key in ("score", "max_score"):
            ElementTree.SubElement(properties, "property", name=key, value=f"{test[key]:g}")
        if test["status"] != "passed":
            failure = ElementTree.SubElement(case, "failure", message=reason.partition("\n")[0])
            failure.text = reason

    # Counts
    failures = sum(test["status"] != "passed" for test in content["tests"])
    if extra["complete"]:
        suite.attrib |= {"tests": str(len(content["tests"])), "failures": str(failures)}
    ElementTree.indent(suite)
    return ElementTree.tostring(suite, encoding="unicode", xml_declaration=True) + "\n"


FORMATS = {each.__name__: each for each in (gradescope, prairielearn, classroom50, junit)}


def _tests(content: Content) -> Iterator[tuple[Mapping[str, Any], str]]:
    """Yield each test of a results file together with the reason of its result.

    The reason of a test that students must not see is replaced by a neutral sentence. The reason of
    a test that has passed is empty.
    """
    for test in content["tests"]:
        shown = test["visibility"] == "visible" or not test["output"]
        yield test, test["output"] if shown else "The reason is not shown for this test."


def _json(content: Content) -> str:
    """Format JSON; numbers that are not finite raise ValueError."""
    return json.dumps(content, indent=1, allow_nan=False) + "\n"
