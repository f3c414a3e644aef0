"""What a learned law suggests to look at: a law has no name, but its place and its signal have meanings."""

from __future__ import annotations

LOOK = {
    ("learned_torque", "dtheta"): (
        "what brakes or drives the motor by its speed: grease and seals, limits of a controller or a"
        " current, a speed at which something resonates"
    ),
    ("learned_torque", "theta"): (
        "what pulls or rubs at places of the motor's turn: gear teeth, bearings, a belt's seam, a brake that"
        " drags, a cable over the motor's side"
    ),
    ("learned_torque", "tau_t"): (
        "what the motor needs or loses by its load: the torque constant at high current, losses of the gear,"
        " a load cell's or a current sensor's curve"
    ),
    ("learned_torque", "tau_m"): (
        "what becomes of the commanded torque: a dead zone or a limit of the drive, the torque constant,"
        " losses of the gear that grow with the load"
    ),
    ("learned_torque", "tau_m_before"): (
        "how the drive of the joint before acts on this one: a differential, tendons, bearing loads, a cable"
        " harness, a supply that both share"
    ),
    ("learned_torque", "tau_m_after"): (
        "how the drive of the joint after acts on this one: a differential, tendons, bearing loads, a cable"
        " harness, a supply that both share"
    ),
    ("learned_link_torque", "q"): (
        "what pulls at the link by its pose: hoses and cables, a spring or counterweight that balances it, a"
        " stop, a body whose mass or place is wrong"
    ),
    ("learned_link_torque", "dq"): (
        "what brakes the link by its speed: its bearing and seals, hoses that drag, a damper, air or water"
    ),
    ("learned_deflection", "theta"): (
        "whether the gear turns evenly: teeth, eccentric mounting, the encoders' own errors over a turn"
    ),
    ("learned_deflection", "phi"): (
        "how the spring gives way: contact of teeth, play that is taken up softly, an elastomer, a stop"
        " of the spring"
    ),
}


def advice(effect: str, signal: str, other: str = "") -> str:
    """A sentence without its end."""
    if other:
        first, second = (LOOK["learned_torque", name] for name in (signal, other))
        return f"look at {first}; and, as it takes both signals, at {second}"
    return f"look at {LOOK[effect, signal]}"
