"""The scenes."""

from pipeline.simulation.meshes.scenes.halls import garage, lobby, stairs, warehouse
from pipeline.simulation.meshes.scenes.outdoors import park, street
from pipeline.simulation.meshes.scenes.rooms import corridor, office, room

SCENES = {
    build.__name__: build
    for build in (corridor, garage, lobby, office, park, room, stairs, street, warehouse)
}
"""What builds each kind, on an empty stage."""
