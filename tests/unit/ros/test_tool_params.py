"""Values of parameters on the command line."""

from __future__ import annotations

import pytest

from support.simulation import require

require("rclpy")

from rcl_interfaces.msg import ParameterType  # noqa: E402

from gibson_sim.errors import GibsonSimError  # noqa: E402
from gibson_sim.ros.tools.params import parameter_value  # noqa: E402

pytestmark = pytest.mark.ros

NOT_SET = ParameterType.PARAMETER_NOT_SET


@pytest.mark.parametrize(
    ("text", "declared", "field", "value"),
    [
        ("true", ParameterType.PARAMETER_BOOL, "bool_value", True),
        ("2", ParameterType.PARAMETER_DOUBLE, "double_value", 2.0),
        ("2", ParameterType.PARAMETER_STRING, "string_value", "2"),
        ("'2'", ParameterType.PARAMETER_STRING, "string_value", "2"),
        ("a: b: c", ParameterType.PARAMETER_STRING, "string_value", "a: b: c"),
        ("", ParameterType.PARAMETER_STRING, "string_value", ""),
        ("[1, 2]", ParameterType.PARAMETER_STRING, "string_value", "[1, 2]"),
        ("[1, 2]", ParameterType.PARAMETER_DOUBLE_ARRAY, "double_array_value", [1.0, 2.0]),
        ("[1, 2]", ParameterType.PARAMETER_INTEGER_ARRAY, "integer_array_value", [1, 2]),
        ("[1, 2]", ParameterType.PARAMETER_BYTE_ARRAY, "byte_array_value", [b"\1", b"\2"]),
        ("[a, b]", ParameterType.PARAMETER_STRING_ARRAY, "string_array_value", ["a", "b"]),
        ("[]", ParameterType.PARAMETER_STRING_ARRAY, "string_array_value", []),
    ],
)
def test_a_value_has_the_declared_type(text: str, declared: int, field: str, value: object) -> None:
    message = parameter_value("x", text, declared)
    found = getattr(message, field)
    assert message.type == declared and (list(found) if isinstance(value, list) else found) == value


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("yes", ParameterType.PARAMETER_BOOL),
        ("1", ParameterType.PARAMETER_INTEGER),
        ("1.0", ParameterType.PARAMETER_DOUBLE),
        ("one", ParameterType.PARAMETER_STRING),
        ("{a: 1}", ParameterType.PARAMETER_STRING),
        ("[yes, no]", ParameterType.PARAMETER_BOOL_ARRAY),
        ("[1, 2]", ParameterType.PARAMETER_INTEGER_ARRAY),
        ("[1, 2.5]", ParameterType.PARAMETER_DOUBLE_ARRAY),
        ("[a, b]", ParameterType.PARAMETER_STRING_ARRAY),
        ("[1, a]", ParameterType.PARAMETER_STRING),
        ("[1, yes]", ParameterType.PARAMETER_STRING),
    ],
)
def test_a_parameter_without_a_declared_type_gets_that_of_its_value(text: str, kind: int) -> None:
    assert parameter_value("x", text, NOT_SET).type == kind


@pytest.mark.parametrize(
    ("text", "declared", "allowed"),
    [
        ("1", ParameterType.PARAMETER_BOOL, "boolean: true or false"),
        ("fast", ParameterType.PARAMETER_DOUBLE, "double: a number, such as 1.5"),
        ("1.5", ParameterType.PARAMETER_INTEGER, "integer: a whole number of at most 64 bits"),
        ("9223372036854775808", ParameterType.PARAMETER_INTEGER, "integer: a whole number of at most 64 bits"),
        ("9223372036854775808", NOT_SET, "integer: a whole number of at most 64 bits"),
        ("1", ParameterType.PARAMETER_DOUBLE_ARRAY, "double array: a list, such as [1.0, 2.5]"),
        ("[1, 2", ParameterType.PARAMETER_DOUBLE_ARRAY, "double array: a list, such as [1.0, 2.5]"),
        ("[1, 256]", ParameterType.PARAMETER_BYTE_ARRAY, "byte array: a list of 0 to 255, such as [1, 2]"),
    ],
)
def test_another_value_is_refused_with_the_allowed_ones(text: str, declared: int, allowed: str) -> None:
    with pytest.raises(GibsonSimError) as error:
        parameter_value("x", text, declared)
    assert str(error.value) == f"parameter 'x' is {text!r}, must be of type {allowed}"
