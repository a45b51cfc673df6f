"""The course: assignments, and the tools that release, judge and grade them.

| package | contents |
|---|---|
| `grade/` | points and reasons for submissions |
| `author/` | checks of an assignment and its mutants, and its release |
| `student/` | a student's folder, the cells of the notebook, and the archive that is handed in |
| `judge/` | the pytest plugin, and the processes that run submissions |
| this folder | shared modules: assignments, rubrics, released material, notebooks |

Imports point downwards in this table. `grade` and `author` do not import each other.
"""
