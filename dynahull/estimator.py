"""The method as a scikit-learn outlier detector: ghosts are the outliers of a map."""

from collections.abc import Mapping
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import issparse
from sklearn.base import BaseEstimator, OutlierMixin
from sklearn.utils import check_random_state
from sklearn.utils.validation import check_is_fitted, validate_data

from dynahull.algorithm import clean
from dynahull.checking import as_array, cloud_points, remedy
from dynahull.clustering import Clusters
from dynahull.density import SMALLEST_CLUSTER
from dynahull.errors import InvalidParametersError, InvalidPointsError
from dynahull.parameters import MethodParameters
from dynahull.reference import reference_densities


class DynaHull(OutlierMixin, BaseEstimator):  # type: ignore[misc]  # untyped bases
    """Density-centric filter of dynamic points (arXiv 2401.07541) as a scikit-learn estimator.

    Parameters
    ----------
    k : int, default=75
        Neighbours of a hull, the point itself included.
    n_clusters : int, default=5
        Clusters of the ground-free points.
    min_percent, max_percent : float, default=5.0 and 20.0
        Percent removed from the smallest and from the largest cluster (Eq. 1).
    threshold : {"rank", "stepped"}, default="rank"
        How the removal threshold of a cluster is found.
    ground : {"none", "slope", "csf"}, default="none"
        How ground is set aside before the scoring. Arrays given to an estimator are seldom whole
        maps, so it is off unless asked for.
    random_state : int, RandomState or None, default=0
        Seed of the clustering.
    decision : {"paper", "auto"}, default="paper"
        Whether a share of each cluster goes (Eq. 1), or what the evidence says moved.
    confidence : float, default=0.5
        Of `auto`: the least probability of having moved that goes.
    configuration : str, MethodParameters, mapping or None, default=None
        What `dynahull.clean` takes as `parameters`, such as `"auto"`, in place of all others
        here: the labels are those of `clean`.

    Attributes
    ----------
    labels_ : (n_samples,) int array
        1 for points that stay, -1 for ghosts.
    density_ : (n_samples,) float64 array
        Points per cubic metre; NaN for ground and for clusters of fewer than four points.
    score_ : (n_samples,) float32 array
        Probability of having moved, by the evidence; NaN where not scored, or not weighed.
    cluster_ : (n_samples,) int32 array
        Cluster of every point, -1 for ground.
    cluster_centers_ : (n_clusters_, 3) float64 array
        Centroids.
    removal_percentages_ : (n_clusters_,) float64 array
        R_i of Eq. 1.
    n_features_in_ : int
        Three, always.

    Examples
    --------
    >>> import numpy as np
    >>> from dynahull import DynaHull
    >>> wall = np.random.default_rng(0).uniform(size=(500, 3)) * [4, 0.02, 2]
    >>> ghost = np.random.default_rng(1).uniform(size=(25, 3)) * [4, 4, 2]
    >>> labels = DynaHull(k=20, n_clusters=1).fit_predict(np.vstack([wall, ghost]))
    >>> int((labels == -1).sum())
    26
    """

    def __init__(
        self,
        k: int = 75,
        n_clusters: int = 5,
        min_percent: float = 5.0,
        max_percent: float = 20.0,
        threshold: Literal["rank", "stepped"] = "rank",
        ground: Literal["none", "slope", "csf"] = "none",
        random_state: int | np.random.RandomState | None = 0,
        decision: Literal["paper", "auto"] = "paper",
        confidence: float = 0.5,
        configuration: str | MethodParameters | Mapping[str, Any] | None = None,
    ) -> None:
        self.k = k
        self.n_clusters = n_clusters
        self.min_percent = min_percent
        self.max_percent = max_percent
        self.threshold = threshold
        self.ground = ground
        self.random_state = random_state
        self.decision = decision
        self.confidence = confidence
        self.configuration = configuration

    def fit(
        self,
        X: ArrayLike,  # noqa: N803
        y: None = None,
        scan: ArrayLike | None = None,
        poses: ArrayLike | None = None,
    ) -> Self:
        """Label every point of a map.

        Parameters
        ----------
        X : (n_samples, 3) array_like
            The map, in metres.
        y : None
            Ignored.
        scan, poses : array_like, optional
            See `dynahull.clean`.

        Returns
        -------
        DynaHull
            Itself.
        """
        points = self._checked(X, ensure_min_samples=2)
        if points.shape[1] != 3:
            raise InvalidPointsError(
                f"X: expected 3 features (x, y, z), found {points.shape[1]} feature(s)"
                f"{remedy(points.shape, 'X')}"
            )
        parameters = self._parameters()
        result = clean(points, parameters, scan=scan, poses=poses)
        self.labels_ = np.where(result.kept, 1, -1)
        self.density_ = result.density
        self.score_ = result.score
        self.cluster_ = result.cluster
        self.cluster_centers_ = np.array([cluster.centroid for cluster in result.clusters])
        self.removal_percentages_ = result.removal_percentages
        self._points, self._neighbours = points, parameters.neighbours.k
        return self

    def fit_predict(self, X: ArrayLike, y: None = None, **kwargs: Any) -> NDArray[np.int64]:  # noqa: N803
        """Label every point of a map: 1 stays, -1 is a ghost.

        Parameters
        ----------
        X : (n_samples, 3) array_like
            The map, in metres.
        y : None
            Ignored.
        **kwargs
            `scan` and `poses`, as `fit` takes them; others that scikit-learn's meta-estimators pass
            are ignored.

        Returns
        -------
        (n_samples,) int array
        """
        return np.asarray(self.fit(X, scan=kwargs.get("scan"), poses=kwargs.get("poses")).labels_)

    def score_samples(self, X: ArrayLike) -> NDArray[np.float64]:  # noqa: N803
        """Measure the density of the fitted map around any points: low where ghosts are.

        Around a point that was fitted, and scored, it is the point's own `density_`, to rounding.

        Parameters
        ----------
        X : (n, 3) array_like
            Where to measure.

        Returns
        -------
        (n,) float64 array
            k / v over the k nearest fitted points of the nearest cluster; infinite where their
            hull has no volume or they are fewer than four.
        """
        check_is_fitted(self)
        points = self._checked(X, reset=False)
        scores = np.full(len(points), np.inf)
        if not len(self.cluster_centers_):
            return scores
        nearest = Clusters(self.cluster_centers_).nearest(points)
        for cluster in np.unique(nearest):
            members = np.flatnonzero(self.cluster_ == cluster)
            if len(members) >= SMALLEST_CLUSTER:
                scores[nearest == cluster] = reference_densities(
                    self._points[members],
                    members,
                    self._neighbours,
                    centres=points[nearest == cluster],
                )
        return scores

    def _checked(self, given: ArrayLike, **wanted: Any) -> NDArray[np.float64]:
        """Return points as scikit-learn wants them; what is no array is refused at once."""
        given = cloud_points(given)
        if not issparse(given):  # whose error is scikit-learn's own
            given = as_array(given, "X", "an (n_samples, 3) array")
        try:
            checked = validate_data(self, given, dtype=np.float64, order="C", **wanted)
        except (TypeError, ValueError) as error:
            raise InvalidPointsError(f"X: {' '.join(str(error).split())}") from error
        return np.asarray(checked)

    def _seed(self) -> int:
        if isinstance(self.random_state, int | np.integer):
            return int(self.random_state)
        try:
            return int(check_random_state(self.random_state).randint(2**31))
        except ValueError as error:
            raise InvalidParametersError(f"random_state: {error}") from error

    def _parameters(self) -> MethodParameters:
        if self.configuration is not None:
            return MethodParameters.chosen(self.configuration, {})
        return MethodParameters.of(
            {
                "ground": {"method": self.ground},
                "clustering": {"count": self.n_clusters, "seed": self._seed()},
                "neighbours": {"k": self.k},
                "removal": {
                    "min_percent": self.min_percent,
                    "max_percent": self.max_percent,
                    "threshold": self.threshold,
                    "decision": self.decision,
                    "confidence": self.confidence,
                },
            }
        )
