"""Photon transfer after EMVA 1288: gain, noise and saturation of a camera from its frames."""

from radwrap.measure.emva.frames import Stack, read_stacks
from radwrap.measure.emva.transfer import PhotonTransfer, photon_transfer

__all__ = ["PhotonTransfer", "Stack", "photon_transfer", "read_stacks"]
