"""The course: assignments that are released, started, judged and graded.

| room | holds |
|---|---|
| `grade/` | points and reasons for what students hand in |
| `author/` | what must hold of an assignment, its mutants, its release |
| `student/` | a student's folder, its notebook's cells, handing in |
| `judge/` | the pytest plugin and the processes that run submissions |
| here | what all of them share: assignments, rubrics, what students get of them, notebooks |

Imports point downwards in this table; `grade` and `author` do not know each other.
"""
