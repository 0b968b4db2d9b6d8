; Rounding, roots, angles: degrees everywhere.
; after: down = -5
; after: near = -6
; after: away = 3
; after: root = 12
; after: size = 7.5
; after: half = 0.5 +- 0.0000001
; after: zero = 0
; after: angle = 135 +- 0.0001
; after: most = 9
; after: least = -4
; after: power = -8
; after: left = 512
; after: rest = -1
; after: sum = 3
; after: tiny = 0.00009 +- 0.0000000001
; after: thousands = 8500
; after: unit = 1
.PROGRAM main()
  down=INT(-5.462)
  near=ROUND(-5.662)
  away=ROUND(2.5)
  root=SQRT(144)
  size=ABS(-7.5)
  half=SIN(30)
  zero=COS(90)
  angle=ATAN2(1,-1)
  most=MAXVAL(3,9,-4)
  least=MINVAL(3,9,-4)
  power=-2^3
  left=2^3^3
  rest=-7 MOD 3
  sum=2+3 MOD 2
  tiny=9E-5
  thousands=8.5E3
  unit=2^-1*2
.END
