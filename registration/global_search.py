"""What methods that search by features share around their search: clouds described, empty ones, the belief."""

from abc import abstractmethod

from registration.belief import Belief, believe
from registration.features import Doubt, FeatureCloud, FeatureSettings, describe
from registration.method import PairMethod, nothing_known
from registration.types import MotionPrior, Points, RegistrationResult, Status


class FeatureMethod(PairMethod):
    """A method that searches all motions; a prior only says which answers are doubted, and stands in for them.

    Subclasses fill in `search`, and have these settings.

    Attributes:
        believed_turn: standard deviation of the turn of the belief, without a prior [rad].
        features: how clouds are described.
        doubt: which answers are dropped for the belief.
    """

    believed_turn: float
    features: FeatureSettings
    doubt: Doubt

    @abstractmethod
    def search(self, source: FeatureCloud, target: FeatureCloud, belief: Belief) -> RegistrationResult:
        """Register two clouds that are not empty, from no start at all."""

    def prepare_cloud(self, points: Points) -> FeatureCloud:
        """Thin the cloud and compute its features."""
        return describe(points, self.features, self.name)

    def align_pair(self, source: FeatureCloud, target: FeatureCloud, prior: MotionPrior | None) -> RegistrationResult:
        """Search all motions, and say with the belief at hand how far the answer can be trusted."""
        if len(source.points) == 0 or len(target.points) == 0:
            return nothing_known(source.origin, Status.TOO_FEW_POINTS)
        return self.search(source, target, believe(source.points, target.points, prior, self.believed_turn))
