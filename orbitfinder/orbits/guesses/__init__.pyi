from .linear import linear_response as linear_response
from .modes import mode_problem as mode_problem
from .modes import normal_mode as normal_mode
from .modes import normal_modes as normal_modes
from .returns import close_returns as close_returns
from .returns import normal_mode_sum as normal_mode_sum
from .returns import recurrences as recurrences
