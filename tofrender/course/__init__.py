"""The course: assignments that are released, started, judged and graded.

| module | holds |
|---|---|
| `rubric` | what `rubric.toml` says: problems, points, time limits, what students do not get |
| `judge` | the pytest plugin: the fixture `submission`, one marker a problem, a report |
| `client`, `worker` | both ends of the wire between the tests and the code that they judge |
| `expect` | comparisons that say what was expected, what came, and where to look |

A test never imports what it judges. It asks a worker, a process of its own, which loads the
submission, runs a probe of the test's author on it, and answers with arrays.
"""
