"""The course: assignments that are released, started, judged and graded.

| package | holds |
|---|---|
| `grade/` | points and reasons for submissions |
| `author/` | checks of an assignment, its mutants, its release |
| `student/` | a student's folder, its notebook's cells, handing in |
| `judge/` | the pytest plugin and the processes that run submissions |
| here | shared: assignments, rubrics, released material, notebooks |

Imports point downwards in this table; `grade` and `author` do not know each other.
"""
