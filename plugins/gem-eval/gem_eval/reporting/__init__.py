"""``gem report``: the scores of runs, with intervals, plots and examples, as one page that can be mailed."""
