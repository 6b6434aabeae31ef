"""Many designs: recipes, their trials, the records of these, and their summary."""

from deepfsi.sweeps.forecast import check_plan, forecast_cost, photons_needed, plan_lines
from deepfsi.sweeps.model_cards import Collection, DataTerms, DesignRecipe, make_collection
from deepfsi.sweeps.plan import Trial, check_settings, check_used, plan_trials, with_adaptive
from deepfsi.sweeps.ray_cluster import run_on_ray
from deepfsi.sweeps.recipe import PAPER_RATIOS, Recipe, only, parts
from deepfsi.sweeps.records import FinishedTrial, Records, write_table
from deepfsi.sweeps.results import Data, Point, Provenance, Results, read_results, write_results
from deepfsi.sweeps.run import check_kept, compare, run_trials
from deepfsi.sweeps.summary import FoldRecords, provenance_of, summarise_records
from deepfsi.sweeps.workers import Resources, Workers, cores, default_count, processes

__all__ = [
    "PAPER_RATIOS",
    "Collection",
    "Data",
    "DataTerms",
    "DesignRecipe",
    "FinishedTrial",
    "FoldRecords",
    "Point",
    "Provenance",
    "Recipe",
    "Records",
    "Resources",
    "Results",
    "Trial",
    "Workers",
    "check_kept",
    "check_plan",
    "check_settings",
    "check_used",
    "compare",
    "cores",
    "default_count",
    "forecast_cost",
    "make_collection",
    "only",
    "parts",
    "photons_needed",
    "plan_lines",
    "plan_trials",
    "processes",
    "provenance_of",
    "read_results",
    "run_on_ray",
    "run_trials",
    "summarise_records",
    "with_adaptive",
    "write_results",
    "write_table",
]
