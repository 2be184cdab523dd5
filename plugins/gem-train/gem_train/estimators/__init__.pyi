"""The public names, which are imported on first use."""

from .groups import (
    gigpo_advantages as gigpo_advantages,
    grpo_advantages as grpo_advantages,
    rloo_advantages as rloo_advantages,
)
from .losses import (
    PolicyMetrics as PolicyMetrics,
    aggregate_tokens as aggregate_tokens,
    policy_gradient_loss as policy_gradient_loss,
    ppo_loss as ppo_loss,
    value_loss as value_loss,
)
from .normalization import (
    normalize_advantages as normalize_advantages,
    return_batch_normalization as return_batch_normalization,
)
from .policies import (
    kl_penalty as kl_penalty,
    truncated_importance_weights as truncated_importance_weights,
)
from .returns import discounted_returns as discounted_returns, gae as gae
from .roles import role_baselines as role_baselines
