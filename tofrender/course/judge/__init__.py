"""Judging what a submission answers: `pytest -p tofrender.course.judge.plugin`.

A test never imports what it judges. It asks a worker, a process of its own, which loads the
submission, runs a probe of the test's author on it, and answers with arrays.

| module | holds |
|---|---|
| `plugin` | the pytest plugin: the fixture `submission`, one marker a problem, a report |
| `client`, `worker`, `wire` | tests ask, submissions answer: both ends, and the data between |
| `expect` | comparisons that say what was expected, what came, and where to look |
| `trials` | right and wrong solutions for the tests that students write |
| `inputs` | numbers of the public tests that are others in each term |
| `sandbox`, `processes` | what a process may do, and the end of all that it has started |
| `running` | an assignment's tests in a pytest of their own, and what its report says |
"""
