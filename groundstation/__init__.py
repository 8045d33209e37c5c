"""Ground station that flies teams of multirotors into 3D formations.

After Fathian, Safaoui, Summers and Gans, "Robust 3D Distributed Formation Control with Collision Avoidance".
"""
