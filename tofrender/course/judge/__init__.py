"""Judge of submissions: `pytest -p tofrender.course.judge.plugin`.

A test never imports the submission. It asks a worker, a process of its own, which loads the
submission, runs a probe of the test's author on it, and answers with arrays.

| module | holds |
|---|---|
| `plugin` | the pytest plugin: the fixture `submission`, one marker a problem, a report |
| `client`, `worker`, `wire` | tests ask, submissions answer: both ends, and the data between |
| `expect` | comparisons whose failures show expected and actual values |
| `trials` | right and wrong solutions for the tests that students write |
| `inputs` | numbers of the public tests that are others in each term |
| `forbidden`, `factors` | features that an assignment forbids; answers that are off by a factor |
| `sandbox`, `system_calls`, `processes` | rights of a process, and the end of all its children |
| `running` | an assignment's tests in a pytest of their own, and its report |
"""
