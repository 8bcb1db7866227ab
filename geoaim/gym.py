"""Registers `DrivingEnv` with gymnasium, which finds this module where geoaim is installed.

    env = gymnasium.make("geoaim/Driving-v0", traffic="itra", render_mode="rgb_array")

Elsewhere, such as in a checkout, `import geoaim.gym` comes first. Nothing heavy is loaded before an
environment is made.
"""

ENVIRONMENT = "geoaim/Driving-v0"


def register_environments() -> None:
    """Register what is not yet registered."""
    from gymnasium.envs.registration import register, registry

    if ENVIRONMENT not in registry:
        register(ENVIRONMENT, entry_point="geoaim.prediction.environments:make_environment")


register_environments()
