"""Formats of a results file: `grade --format`, each made from Gradescope's.

Platforms without visibilities of tests get no reason for tests that are not visible.
"""

import datetime
import json
import os
from collections.abc import Iterator, Mapping
from typing import Any
from xml.etree import ElementTree

Content = Mapping[str, Any]
RUN = {
    **{"classroom": "CLASSROOM", "assignment": "ASSIGNMENT", "submission": "SUBMISSION_TAG"},
    **{"commit": "COMMIT_URL", "release": "RELEASE_URL", "review": "REVIEW_URL"},
}
"""Variables in which Classroom 50 names a run."""
POINT = 100  # integers that Classroom 50 gets for a point


def gradescope(content: Content) -> str:
    """Gradescope's `results.json`."""
    return _json(content)


def prairielearn(content: Content) -> str:
    """PrairieLearn's `results.json`, whose score is a fraction and at most 1."""
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
    """Classroom 50's `result.json`: hundredths of points without bonus, names of the run.

    The file is empty, which is no result, if the submission is not graded.
    """
    if not content["extra_data"]["complete"]:
        return ""
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
    given = {name: os.environ.get(variable, "") for name, variable in RUN.items()}
    now = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    given["review"] = given["review"] or given["commit"]
    head: dict[str, Any] = {"schema": "classroom50/result/v1", **given, "datetime": now}
    head["usernames"] = [os.environ.get("USERNAME", "")]
    sums = {name: sum(test[name] for test in tests) for name in ("score", "max-score")}
    return _json(head | sums | {"tests": tests})


def junit(content: Content) -> str:
    """JUnit's XML, a test case for each test; points are properties."""
    extra = content["extra_data"]
    suite = ElementTree.Element("testsuite", name=extra["assignment"])
    if not extra["complete"]:
        case = ElementTree.SubElement(suite, "testcase", name="grading")
        ElementTree.SubElement(case, "error", message=content["output"])
        suite.attrib |= {"tests": "1", "errors": "1"}
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
    failures = sum(test["status"] != "passed" for test in content["tests"])
    if extra["complete"]:
        suite.attrib |= {"tests": str(len(content["tests"])), "failures": str(failures)}
    ElementTree.indent(suite)
    return ElementTree.tostring(suite, encoding="unicode", xml_declaration=True) + "\n"


FORMATS = {each.__name__: each for each in (gradescope, prairielearn, classroom50, junit)}


def _tests(content: Content) -> Iterator[tuple[Mapping[str, Any], str]]:
    """Tests, and the reason that a student may read."""
    for test in content["tests"]:
        shown = test["visibility"] == "visible" or not test["output"]
        yield test, test["output"] if shown else "What this test asks for is not shown."


def _json(content: Content) -> str:
    return json.dumps(content, indent=1, allow_nan=False) + "\n"
