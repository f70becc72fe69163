"""Sensors of one's own: see, sign, push; and adapters from what cameras, scanners and maps give.

A sensor program needs the core alone, and numpy for point clouds: none of the gateway, the physics or a robot's
interface is loaded.
"""

from pep.sensor.camera import Camera
from pep.sensor.detections import PixelBox, SolidBox, detected, person_at
from pep.sensor.keypoints import body_25, by_keypoints, coco_17
from pep.sensor.laser_scanner import ScannerField, entered
from pep.sensor.metres import PersonSight, ball, box, hull, rod, thing
from pep.sensor.sensor import Sensor, SentFrame
from pep.sensor.sensor_error import SensorError, SensorFault
from pep.sensor.voxels import cloud_boxes, octomap_boxes

__all__ = [
    "Camera",
    "PersonSight",
    "PixelBox",
    "ScannerField",
    "Sensor",
    "SensorError",
    "SensorFault",
    "SentFrame",
    "SolidBox",
    "ball",
    "body_25",
    "box",
    "by_keypoints",
    "cloud_boxes",
    "coco_17",
    "detected",
    "entered",
    "hull",
    "octomap_boxes",
    "person_at",
    "rod",
    "thing",
]
