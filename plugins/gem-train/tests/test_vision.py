"""Images in the learner: the same in generation and in learning, where they stand, and a task that has them."""

from __future__ import annotations

import copy

import pytest

from gem_core.testing import check_env

torch = pytest.importorskip("torch")
Image = pytest.importorskip("PIL.Image")

from gem_train.learner.learning import Learner  # noqa: E402 - after the checks for what is optional
from gem_train.learner.options import TrainOptions  # noqa: E402
from gem_train.learner.playing import encode, token_batch  # noqa: E402
from gem_train.learner.policy_loss import score  # noqa: E402
from gem_train.learner.training import Training, warm_start  # noqa: E402
from gem_train.learner.vision import Pictures  # noqa: E402
from gem_train.learner.vocabulary import ANSWER, Vocabulary  # noqa: E402


def picture(colour: str) -> Image.Image:
    return Image.new("RGB", (64, 48), colour)


def image_part(colour: str) -> dict[str, object]:
    return {"type": "image", "image": picture(colour)}


def test_shapes_keep_the_contract() -> None:
    check_env("train:Shapes-v0")


def test_images_keep_their_places_in_a_row() -> None:
    """Words before and after an image stay there; equal images have equal ids, others have others."""
    vocabulary = Vocabulary.build(["left", "right"])
    pictures = Pictures(len(vocabulary))
    red, blue = pictures.ids(picture("red")), pictures.ids(picture("blue"))
    shown = [{"type": "text", "text": "left"}, image_part("blue"), {"type": "text", "text": "right"}, image_part("red")]
    ids = encode([{"role": "user", "content": shown}], vocabulary, pictures)
    assert ids == [
        *vocabulary.encode("user: left"),
        *blue,
        *vocabulary.encode("right"),
        *red,
        *vocabulary.encode("\n"),
        ANSWER,
    ]
    assert len({*red, *blue}) == len(red) + len(blue)
    assert len(pictures) == 2


@pytest.mark.parametrize("memory", [None, 0])
def test_learning_scores_images_as_generation_saw_them(memory: int | None) -> None:
    """Log-probabilities of what was sampled are equal, with keys cached or rows shared, and depend on the image."""
    options = TrainOptions(
        env=("train:Shapes-v0",),
        episodes=8,
        eval_episodes=8,
        updates=2,
        memory=memory,
        max_tokens=4,
        width=16,
        context=96,
        imitate_episodes=8,
        imitate_steps=2,
    )
    learner = warm_start(options)
    before = copy.deepcopy(learner.policy)
    with Training(learner) as training:
        played = training.update().played
    batch = token_batch(played, groups=range(8))
    before.pictures = learner.policy.pictures
    tokens, sampled = torch.from_numpy(batch.tokens), torch.from_numpy(batch.token_mask)
    seen = score(before, tokens, sampled).logprobs
    torch.testing.assert_close(seen[sampled], torch.from_numpy(batch.logprobs)[sampled], rtol=0, atol=2e-5)
    of_images = tokens >= len(learner.vocabulary)
    assert of_images.sum() == 8 * 16
    other = tokens.where(~of_images, tokens.roll(1, 0))
    assert (score(before, other, sampled).logprobs - seen).abs().max() > 1e-3
    seen.sum().backward()
    assert all(parameter.grad.abs().sum() > 0 for parameter in before.vision.parameters())


def test_overlap_learns_from_what_the_weights_before_played() -> None:
    """A batch is scored with its own images, by the weights of one update ago as they sampled it."""
    options = TrainOptions(
        env=("train:Shapes-v0",),
        episodes=8,
        updates=9,
        max_tokens=4,
        width=16,
        context=96,
        overlap=True,
        entropy=-1.0,  # moves the weights, without any reward
        learning_rate=0.01,
    )
    learner = Learner(options, Vocabulary.build(["How many shapes?"]))
    before = copy.deepcopy(learner.policy)
    with Training(learner) as training:
        first, second = training.update(), training.update()
        before.pictures = learner.policy.pictures
    batch = token_batch(second.played, groups=range(8))
    tokens, sampled = torch.from_numpy(batch.tokens), torch.from_numpy(batch.token_mask)
    logprobs = torch.from_numpy(batch.logprobs)
    torch.testing.assert_close(score(before, tokens, sampled).logprobs[sampled], logprobs[sampled], rtol=0, atol=2e-5)
    assert abs(first.metrics["kl"]) < 1e-5 < second.metrics["kl"]
