"""How Zemax's text exports print numbers and units of length."""

NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
UM = "(?:[µμu]m)"
MILLIMETRES = {"millimeters": 1.0, "centimeters": 10.0, "inches": 25.4, "meters": 1000.0}
