"""Gazebo SDF: the body and one `gz-sim-multicopter-motor-model-system` plugin a motor.

The plugin takes rotor speeds in rad/s, thrust goes with their square, and it has a lag up and one down. Full
command is `full_speed` here. The rotors' drag is the plugin's; that of the body is left out.
"""

from __future__ import annotations

from xml.sax.saxutils import escape

import numpy as np

from flysid.export.vehicles.body import ARM_M, MASS_KG, body_of, with_trim_in_places
from flysid.sixdof.fitted import FittedVehicle
from flysid.sixdof.layout import LAG

FULL_SPEED = 1000.0

_LINK = """    <link name="rotor_{i}">
      <pose>{x:.9g} {y:.9g} 0 0 0 0</pose>
      <inertial>
        <mass>{mass:.9g}</mass><inertia><ixx>1e-9</ixx><iyy>1e-9</iyy><izz>1e-9</izz></inertia>
      </inertial>
    </link>
    <joint name="rotor_{i}_joint" type="revolute">
      <parent>base_link</parent>
      <child>rotor_{i}</child>
      <axis><xyz>0 0 1</xyz></axis>
    </joint>
    <plugin filename="gz-sim-multicopter-motor-model-system" name="gz::sim::systems::MulticopterMotorModel">
      <jointName>rotor_{i}_joint</jointName>
      <linkName>rotor_{i}</linkName>
      <turningDirection>{way}</turningDirection>
      <timeConstantUp>{lag:.9g}</timeConstantUp>
      <timeConstantDown>{lag:.9g}</timeConstantDown>
      <maxRotVelocity>{full:.9g}</maxRotVelocity>
      <motorConstant>{k:.9g}</motorConstant>
      <momentConstant>{moment:.9g}</momentConstant>
      <commandSubTopic>command/motor_speed</commandSubTopic>
      <motorNumber>{i}</motorNumber>
      <rotorDragCoefficient>{drag:.9g}</rotorDragCoefficient>
      <rollingMomentCoefficient>0</rollingMomentCoefficient>
      <motorType>velocity</motorType>
    </plugin>
"""
ROTOR_SHARE = 1e-4
"""Of the mass, each rotor: Gazebo wants links to weigh something."""


def sdf_model(
    vehicle: FittedVehicle,
    name: str,
    mass_kg: float = MASS_KG,
    arm_m: float = ARM_M,
    full_speed: float = FULL_SPEED,
) -> str:
    """The model as SDF 1.9; raises as `body_of`."""
    body = body_of(vehicle, mass_kg, arm_m)
    places = with_trim_in_places(body, vehicle)
    own = body.mass_kg * ROTOR_SHARE
    rotors = [
        _LINK.format(
            i=i,
            x=place[0],
            y=place[1],
            mass=own,
            way="cw" if yaw > 0.0 else "ccw",  # a rotor that turns clockwise turns the body the other way
            lag=float(vehicle.theta[LAG]),
            full=full_speed,
            k=body.thrust_n / full_speed**2,
            moment=abs(yaw) / body.thrust_n,
            drag=float(np.mean(body.rotor_drag[:2])) / full_speed,
        )
        for i, (place, yaw) in enumerate(zip(places, body.yaw_nm, strict=True))
    ]
    ixx, iyy, izz = (f"{moment:.9g}" for moment in body.inertia)
    return (
        '<?xml version="1.0"?>\n<sdf version="1.9">\n'
        f'  <model name="{escape(name, {chr(34): "&quot;"})}">\n    <link name="base_link">\n      <inertial>'
        f"<mass>{body.mass_kg - vehicle.motors * own:.9g}</mass><inertia><ixx>{ixx}</ixx><iyy>{iyy}</iyy>"
        f"<izz>{izz}</izz></inertia></inertial>\n    </link>\n{''.join(rotors)}  </model>\n</sdf>\n"
    )
