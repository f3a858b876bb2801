"""The log of a real board, which another program wrote."""

import numpy as np
import pandas as pd
import pytest

from ilctools import load_log, read_table
from ilctools.errors import LogError
from rodlib.paper import ROOT

BOARD = ROOT / "data" / "tclab" / "board-1s.csv"
COLUMNS = {
    "time": "Time",
    "outputs": {"T1": "Temperature 1", "T2": "Temperature 2 (degC)"},
    "inputs": {"Q1": "Heater 1 (%)", "Q2": "Heater 2"},
}


def test_the_log_of_a_real_board_is_what_pandas_reads():
    log = read_table(BOARD, **COLUMNS)
    table = pd.read_csv(BOARD, skipinitialspace=True).to_numpy()
    np.testing.assert_array_equal(log.u[0], table[:, 1:3])
    np.testing.assert_array_equal(log.y[0], table[:, 3:5])
    assert log.attrs["Ts"] == 1.0 and log.output_unit.values.tolist() == ["degC"] * 2
    assert log.attrs["clock"].startswith("the steps are from 0.9903 to 1.021 s, with median 1.001")
    with pytest.raises(LogError, match=r"format is None.*read_table"):
        load_log(BOARD)
