"""Direct Bayesian identification of inverse systems (Suzuki, Oomen, Gonzalez, 2025).

The inverse's FIR taps from input and noisy output of the forward system: the paper's Algorithm 1,
the methods it compares with, and a posterior mean without its EM loop.
"""

from ffl.identify.bayes.algorithm_1 import Algorithm1Fit, algorithm_1
from ffl.identify.bayes.compared import naive, oracle, two_step
from ffl.identify.bayes.diagnostics import effective_sample_size, split_rhat
from ffl.identify.bayes.estimator import Algorithm1Inverse, DirectBayesianInverse
from ffl.identify.bayes.posterior import Posterior, direct_posterior
from ffl.identify.bayes.protocol import inverse_fit, paper_data
from ffl.identify.bayes.records import Record, reduce_record
from ffl.identify.bayes.roots import forward_response
from ffl.identify.bayes.table import Row, TableOne, reproduce, table_one

__all__ = [
    "Algorithm1Fit",
    "Algorithm1Inverse",
    "DirectBayesianInverse",
    "Posterior",
    "Record",
    "Row",
    "TableOne",
    "algorithm_1",
    "direct_posterior",
    "effective_sample_size",
    "forward_response",
    "inverse_fit",
    "naive",
    "oracle",
    "paper_data",
    "reduce_record",
    "reproduce",
    "split_rhat",
    "table_one",
    "two_step",
]
