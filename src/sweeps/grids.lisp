;;; anmech: the points of a sweep, each computed from its number alone.
;;;
;;; So a grid of any size is a few numbers, and a point is the same whoever asks for it, and in whatever order.
;;;
;;; An axis is a list of Maxima's: [values, x, ...]; [range, a, b, n], n equidistant numbers; [between, a, b], any
;;; numbers.  Points are numbered from 0.
;;;
;;; Entry points: GRID-POINT, QUICK-AXES, AXIS-LENGTH, MIXED-BITS; anmech_grid_points, anmech_axis_length.

(in-package :anmech)
(needs "algebra/terms" "numerics/dag")

(defun axis-length (axis)
  (ecase (second axis)
    (maxima::$values (length (cddr axis)))
    (maxima::$range (fifth axis))
    (maxima::$between nil)))

(maxima::defmfun maxima::$anmech_axis_length (axis)
  "anmech_axis_length(axis): how many values it has; false: any number."
  (axis-length axis))

(defun quick-axes (axes &optional (count 0))
  "AXES, a list of Maxima's, as a list of Lisp's, with vectors of values: none of many is far away.  COUNT points will
be asked for, so that a range of fewer is worth its computation."
  (loop for axis in (rest axes)
        for length = (axis-length axis)
        collect (cond ((eq (second axis) 'maxima::$values)
                       (list* (first axis) (second axis) (coerce (cddr axis) 'simple-vector)))
                      ((and length (<= length 100000) (<= (* 10 length) count))
                       (let ((values (make-array length)))
                         (dotimes (place length)
                           (setf (svref values place) (axis-value axis place)))
                         (list* (first axis) 'maxima::$values values)))
                      (t axis))))

(defun axis-value (axis place)
  (ecase (second axis)
    (maxima::$values (elt (cddr axis) place))
    (maxima::$range (range-value (third axis) (fourth axis) (fifth axis) place))))

(defun range-value (start end count place)
  "Rounded once, so that every machine has the same."
  (if (= count 1)
      start
      (let ((a (rational start)) (b (rational end)))
        (to-double (+ a (/ (* place (- b a)) (1- count)))))))

(defun mixed-bits (number)
  "64 bits that nothing in those of NUMBER seems to determine: G. Steele, D. Lea, C. Flood (2014), SplitMix64."
  (flet ((bits (number) (logand number #xffffffffffffffff)))
    (let* ((z (bits (* (1+ number) #x9e3779b97f4a7c15)))
           (z (bits (* (logxor z (ash z -30)) #xbf58476d1ce4e5b9)))
           (z (bits (* (logxor z (ash z -27)) #x94d049bb133111eb))))
      (logxor z (ash z -31)))))

(defun random-value (axis seed number place)
  (let ((bits (mixed-bits (+ (mixed-bits (+ (mixed-bits seed) number)) place))))
    (if (eq (second axis) 'maxima::$between)
        (let ((part (* (ash bits -11) (expt 2d0 -53))))
          (+ (* (- 1d0 part) (third axis)) (* part (fourth axis))))
        (axis-value axis (mod bits (axis-length axis))))))

(defun grid-point (axes way seed number)
  "The values of AXES at the point NUMBER; WAY is product (the last axis runs fastest), zipped or random."
  (ecase way
    (maxima::$product
     (let ((values '()) (left number))
       (dolist (axis (reverse axes) values)
         (multiple-value-bind (quotient place) (floor left (axis-length axis))
           (push (axis-value axis place) values)
           (setq left quotient)))))
    (maxima::$zipped (mapcar (lambda (axis) (axis-value axis number)) axes))
    (maxima::$random (loop for axis in axes
                           for place from 0
                           collect (random-value axis seed number place)))))

(maxima::defmfun maxima::$anmech_grid_points (axes way seed first count)
  "anmech_grid_points(axes, way, seed, first, count): so many points from the one numbered FIRST."
  (let ((axes (quick-axes axes count)))
    (maxima-list (loop for number from first below (+ first count)
                       collect (maxima-list (grid-point axes way seed number))))))
