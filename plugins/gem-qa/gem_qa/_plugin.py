"""What this distribution offers; it imports no environment."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from gem_core.registry import EnvSpec, hookimpl

_ENTRY = "gem_qa:QAEnv"
_SEARCH_EVAL = {
    "2Wiki": ("2wiki", "2WikiMultihopQA"),
    "PopQA": ("popqa", "PopQA"),
    "TriviaQA": ("tq", "TriviaQA"),
    "HotpotQA": ("hotpotqa", "HotpotQA"),
    "Bamboogle": ("bamboogle", "Bamboogle"),
    "NaturalQuestions": ("nq", "Natural Questions"),
    "Musique": ("musique", "MuSiQue"),
}


@hookimpl
def gem_register_envs() -> Iterable[EnvSpec]:
    """The data sets of gem-llm under its ids, and a sample that needs no network."""
    yield EnvSpec(
        id="qa:Sample",
        entry_point=_ENTRY,
        kwargs={
            "dataset_name": "gem_qa:data/sample.jsonl",
            "answer_key": "answers",
            "id_key": "id",
        },
        summary="Questions on the 200 articles of gem-tools, in one hop or two; works offline.",
        tags=("qa", "text", "search"),
    )
    yield _hub("qa:NaturalQuestions", "axon-rl/NaturalQuestions", "train", "problem", "Natural Questions, to train on.")
    yield _hub("qa:HotpotQA", "axon-rl/HotpotQA", "train", "problem", "HotpotQA, to train on.")
    yield from _logic()
    for name, (split, title) in _SEARCH_EVAL.items():
        yield _hub(f"eval:{name}", "axon-rl/search-eval", split, "question", f"{title}, 512 questions to evaluate on.")
    open_set, summary = "google-research-datasets/nq_open", "Natural Questions (open), development questions."
    yield _hub("eval:QaOpen", open_set, "validation", "question", summary)


def _logic() -> Iterator[EnvSpec]:
    for depth in (0, 1, 2, 3, 5):
        yield _hub(
            f"logic:RuleTaker-d{depth}",
            f"axon-rl/RuleTaker-d{depth}-70k",
            "train",
            "question",
            f"Whether a statement follows from facts and rules, by proofs of depth {depth}.",
            extract_boxed=True,
        )


def _hub(env_id: str, dataset: str, split: str, question_key: str, summary: str, **more: object) -> EnvSpec:
    namespace = env_id.partition(":")[0]
    return EnvSpec(
        id=env_id,
        entry_point=_ENTRY,
        kwargs={
            "dataset_name": dataset,
            "split": split,
            "question_key": question_key,
            "answer_key": "answer",
            **more,
        },
        summary=summary,
        tags=tuple(dict.fromkeys((namespace, "logic" if more else "qa", "text"))),
        requires=("hub",),
    )
