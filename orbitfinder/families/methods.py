"""The methods whose families are followed here, for the table of methods."""

from orbitfinder.families.balance import followed, reverified
from orbitfinder.orbits import balance
from orbitfinder.orbits.method import METHODS, Method

METHODS[balance.NAME] = Method(
    balance.suits,
    balance.balanced,
    balance.refused,
    follow=followed,
    verify=reverified,
    remedy='a series knows sharp corners badly: make smoothing larger, or take method = "shooting"',
)
