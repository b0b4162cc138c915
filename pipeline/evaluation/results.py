"""One evaluation from files to files."""

from pathlib import Path

from pipeline.errors import ConfigurationError, OutputError
from pipeline.evaluation.evaluate import evaluate
from pipeline.evaluation.inputs import find_inputs
from pipeline.evaluation.options import EvaluationOptions
from pipeline.evaluation.report import EvaluationReport
from pipeline.progress import watching
from pipeline.replacing import RUN_FILE
from pipeline.showing import check_named_file, drawing_library
from tiling.atomic import atomic_file


def evaluate_files(
    cleaned: str,
    truth: str,
    original: str | None,
    options: EvaluationOptions,
    json_file: Path | None = None,
    picture: Path | None = None,
) -> EvaluationReport:
    """Evaluate a cleaned map, and write what was asked for.

    Parameters
    ----------
    cleaned, truth, original : str
        As `inputs.find_inputs` takes them.
    options : EvaluationOptions
    json_file, picture : Path, optional
        Where to write all figures, and the map from above.

    Returns
    -------
    EvaluationReport

    Raises
    ------
    PipelineError, TilingError
        With nothing written but, perhaps, the picture.
    """
    named = [Path(cleaned), Path(cleaned) / RUN_FILE, Path(truth)]
    for path, kind in ((json_file, ".json"), (picture, ".png")):
        if path is not None:
            check_named_file(path, kind, named)
    inputs = find_inputs(cleaned, truth, original, options)
    if picture is not None:
        if inputs.original is None:
            raise ConfigurationError("--picture: expected --original, found none")
        drawing_library()  # before the work, not after it
    with watching() as observer:
        if inputs.original is None and (Path(cleaned) / RUN_FILE).is_file():
            observer.warn(
                f"{cleaned}: the map that was cleaned is no longer there; only distances are "
                "measured (--original says where it is)"
            )
        figures = evaluate(inputs, options, observer, picture)
    report = EvaluationReport.of(inputs, truth, options, figures, observer)
    if json_file is not None:
        try:
            with atomic_file(json_file) as temporary:
                temporary.write_text(report.to_json(), encoding="utf-8")
        except OSError as error:
            raise OutputError(f"{json_file}: {error.strerror or error}") from error
    return report
