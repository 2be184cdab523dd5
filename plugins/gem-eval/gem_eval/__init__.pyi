"""The public names, which are imported on first use."""

from .auditing.audit import audit as audit
from .comparing.comparison import compare as compare
from .exporting.tables import to_pandas as to_pandas
from .records import Row as Row, Run as Run, open_run as open_run
from .replaying.replay import replay as replay
from .running.evaluation import evaluate as evaluate
from .running.limits import Limits as Limits
from .scores import Score as Score, compute_scores as compute_scores
from .scoring.grading import score as score
from .suites import Model as Model, Suite as Suite, load_suite as load_suite
