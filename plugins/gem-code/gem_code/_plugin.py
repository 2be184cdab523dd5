"""What this distribution offers; it imports no task."""

from __future__ import annotations

from collections.abc import Iterable

from gem_core.registry import EnvSpec, hookimpl

_ENTRY = "gem_code:CodeEnv"
_ASKED = "\n\nAnswer with the whole program in one fenced block that begins with ```python."


@hookimpl
def gem_register_envs() -> Iterable[EnvSpec]:
    """The data sets, with the names, splits and columns of gem-llm's, whose baselines are published; and our own."""
    program = "Write a program"
    yield EnvSpec(
        id="code:Sample",
        entry_point=_ENTRY,
        kwargs={
            "dataset_name": "gem_code:data/sample.jsonl",
            "id_key": "id",
            "prompt_template": "{question}" + _ASKED,
        },
        summary=f"{program} or a function; problems that ship with the plugin.",
        tags=("code", "text"),
    )
    yield _hub("code:CodeContest", "CodeContest", f"{program}; problems of contests.")
    yield _hub("code:Taco8k", "TACO-8k", f"{program}; problems of TACO.")
    yield _hub("code:PrimeIntellect15k", "PrimeIntellect-15k", f"{program}; problems that Prime Intellect collected.")
    yield _hub("eval:CodeContest", "CodeContest", f"{program}; held-out problems of contests.", split="test")
    yield EnvSpec(
        id="eval:HumanEval",
        entry_point=_ENTRY,
        kwargs={
            "dataset_name": "openai/openai_humaneval",
            "split": "test",
            "question_key": "prompt",
            "test_key": "test",
            "solution_key": "canonical_solution",
            "id_key": "task_id",
            "prompt_template": "Complete this function. Answer with the whole function in one fenced block that begins "
            "with ```python.\n\n```python\n{question}```",
        },
        summary="Complete a function; 164 problems.",
        tags=("code", "text", "eval"),
        requires=("hub",),
    )


def _hub(name: str, dataset: str, summary: str, split: str = "train") -> EnvSpec:
    kwargs = {
        "dataset_name": f"axon-rl/{dataset}",
        "split": split,
        "question_key": "problem",
        "test_key": "tests",
    }
    tags = ("code", "text") if split == "train" else ("code", "text", "eval")
    return EnvSpec(id=name, entry_point=_ENTRY, kwargs=kwargs, summary=summary, tags=tags, requires=("hub",))
