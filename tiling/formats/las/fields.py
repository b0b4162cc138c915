"""The fields of the point formats of LAS 1.0 to 1.4, by the names that laspy gives them.

Written down here, and compared with laspy in a test: to ask laspy means to import it, with what it
needs for geodesy and for the network, before a run knows how large its map is.
"""

from tiling.formats.points import Field

_FIRST = "X:int32 Y:int32 Z:int32 intensity:uint16 return_number number_of_returns"
_SHORT = (
    f"{_FIRST} scan_direction_flag edge_of_flight_line classification synthetic key_point withheld "
    "scan_angle_rank:int8 user_data point_source_id:uint16"
)
_LONG = (
    f"{_FIRST} synthetic key_point withheld overlap scanner_channel scan_direction_flag "
    "edge_of_flight_line classification user_data scan_angle:int16 point_source_id:uint16 "
    "gps_time:float64"
)
_TIME = "gps_time:float64"
_COLOUR = "red:uint16 green:uint16 blue:uint16"
_INFRARED = "nir:uint16"
_WAVEFORM = (
    "wavepacket_index wavepacket_offset:uint64 wavepacket_size:uint32 "
    "return_point_wave_location:float32 x_t:float32 y_t:float32 z_t:float32"
)

_FIELDS = (
    (_SHORT,),
    (_SHORT, _TIME),
    (_SHORT, _COLOUR),
    (_SHORT, _TIME, _COLOUR),
    (_SHORT, _TIME, _WAVEFORM),
    (_SHORT, _TIME, _COLOUR, _WAVEFORM),
    (_LONG,),
    (_LONG, _COLOUR),
    (_LONG, _COLOUR, _INFRARED),
    (_LONG, _WAVEFORM),
    (_LONG, _COLOUR, _INFRARED, _WAVEFORM),
)


def standard_fields(point_format: int) -> tuple[Field, ...]:
    """Return the fields of a point format, 0 to 10; those of a few bits are uint8."""
    words = " ".join(_FIELDS[point_format]).split()
    parts = (word.partition(":") for word in words)
    return tuple(Field(name, dtype or "uint8") for name, _, dtype in parts)
