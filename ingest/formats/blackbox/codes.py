"""The numbers by which a blackbox header and its frames name encodings, predictors and events.

Source: the firmwares' `blackbox_fielddefs.h`.
"""

from enum import IntEnum


class Encoding(IntEnum):
    """How a field's number is written."""

    SIGNED_VB = 0
    UNSIGNED_VB = 1
    NEG_14BIT = 3
    TAG8_8SVB = 6
    TAG2_3S32 = 7
    TAG8_4S16 = 8
    NULL = 9
    TAG2_3SVARIABLE = 10


class Predictor(IntEnum):
    """What is added to a field's number."""

    NOTHING = 0
    PREVIOUS = 1
    STRAIGHT_LINE = 2
    AVERAGE = 3
    CONSTANT = 4
    MOTOR_0 = 5
    INCREMENT = 6
    AT_HOME = 7
    AT_TIME = 10


class EventKind(IntEnum):
    """What an event frame tells."""

    SYNC = 0
    ADJUSTMENT = 13
    RESUME = 14
    DISARM = 15
    MODE = 30
    IMU_FAILURE = 40
    CUSTOM_DATA = 100
    CUSTOM_STRING = 101
    END = 255
